# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""What can be wrong with a gateway, in one line each."""


class GatewayError(ValueError):
    """Something about the gateway that cannot work; the message is one line that says what, where and what to do."""


class MissingExtraError(GatewayError):
    """A protocol was asked for whose package is not installed."""

    def __init__(self, extra: str, package: str) -> None:
        super().__init__(f"this needs {package}, which is not installed: pip install 'ros2-deepc[{extra}]'")


class LinkError(Exception):
    """The field did not answer, or refused; the link has to be made anew or the request given up."""
