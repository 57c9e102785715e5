# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

# Builds the three packages with colcon against the ROS wheels, and runs what was built.
# Usage: colcon.sh PYTHON        (on an installed ROS 2 plain `colcon build` does it)
set -e
venv=build/colcon-venv
sh packaging/venv.sh "$1" "$venv"
if [ ! -e "$venv/.ready" ]; then
    "$venv/bin/python" packaging/requirements.py | xargs -d '\n' "$venv/bin/python" -m pip install --quiet \
        --disable-pip-version-check colcon-common-extensions cmake ninja "setuptools<80"
    touch "$venv/.ready"
fi
. "$venv/bin/activate"
export AMENT_PREFIX_PATH="$VIRTUAL_ENV" CMAKE_PREFIX_PATH="$VIRTUAL_ENV"
colcon --log-base build/colcon-log build --base-paths msgs plant_sim ros2_deepc --build-base build/colcon --install-base build/colcon-install \
    --event-handlers console_cohesion- \
    --cmake-args -DCMAKE_PROJECT_deepc_msgs_INCLUDE="$PWD/packaging/ros_wheels.cmake" -DBUILD_TESTING=OFF
. build/colcon-install/setup.sh
rm -rf build/colcon-run
build/colcon-install/ros2_deepc/lib/ros2_deepc/ros2-deepc demo wscc9 --steps 120 --processes --out build/colcon-run
