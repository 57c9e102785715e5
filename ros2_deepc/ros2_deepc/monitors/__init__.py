# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What the data prove: verdicts with margin, noise level and reason. Pure numpy and scipy."""
