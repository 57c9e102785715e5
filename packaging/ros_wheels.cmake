# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
#
# What plain ament_cmake packages need when ROS comes from PyPI wheels instead of a ROS installation. Included in front of
# project(deepc_msgs) by CMAKE_PROJECT_deepc_msgs_INCLUDE, so that msgs/CMakeLists.txt stays free of it.

# 1. The wheels live in the prefix of the Python environment that imports them.
find_package(Python3 REQUIRED COMPONENTS Interpreter)
execute_process(
  COMMAND "${Python3_EXECUTABLE}" -c
          "import ament_package, pathlib; print(pathlib.Path(ament_package.__file__).resolve().parents[4])"
  OUTPUT_VARIABLE ros_wheels_prefix OUTPUT_STRIP_TRAILING_WHITESPACE COMMAND_ERROR_IS_FATAL ANY)
list(PREPEND CMAKE_PREFIX_PATH "${ros_wheels_prefix}")
set(ENV{AMENT_PREFIX_PATH} "${ros_wheels_prefix}")

# 2. Their exported targets name include folders of the machine they were built on. CMake looks at those only when it generates,
#    so they are dropped at the end of this directory.
function(ros_wheels_drop_foreign_includes)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(folders ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(folders)
      list(FILTER folders EXCLUDE REGEX "^/opt/python/")
      set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${folders}")
    endif()
  endforeach()
endfunction()
cmake_language(DEFER CALL ros_wheels_drop_foreign_includes)

# 3. Python nodes do not need the C++ half of the messages; leaving it out halves the build. A colcon build keeps it (OFF).
option(ROS_WHEELS_PYTHON_ONLY "Generate only what Python needs" OFF)
if(ROS_WHEELS_PYTHON_ONLY)
  find_package(rosidl_default_generators REQUIRED)
  list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "_cpp:")
endif()
