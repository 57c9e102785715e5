# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Data matrices: Hankel matrices, excitation, the online window. Pure numpy and scipy."""

from .hankel import hankel

__all__ = ["hankel"]
