# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Plants: descriptor systems, their canonical form, and the networks."""
