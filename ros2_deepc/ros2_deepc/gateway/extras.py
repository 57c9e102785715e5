# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Modules of the gateway whose protocol is an extra of the distribution."""

from importlib import import_module
from typing import Any

from .errors import MissingExtraError

_PACKAGES = {"modbus": "pymodbus", "opcua": "asyncua"}


def with_extra(extra: str, module: str) -> Any:
    """A module of this package that needs an extra.

    Raises:
        MissingExtraError: if its package is not installed.
    """
    try:
        return import_module(f".{module}", __package__)
    except ModuleNotFoundError as error:
        if error.name and error.name.startswith("ros2_deepc"):
            raise
        raise MissingExtraError(extra, _PACKAGES[extra]) from None
