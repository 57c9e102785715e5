# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""An event loop in a thread of its own, for protocols beside a node."""

import asyncio
import threading
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

T = TypeVar("T")

_PATIENCE = 5.0  # [s] for an answer from the loop
_CLOSING = 0.02  # [s] for closed connections to leave the loop


class LoopThread:
    """Runs coroutines in a thread until ``stop``.

    Args:
        on_failure: called, in the thread, with what ended a coroutine.
    """

    def __init__(self, on_failure: Callable[[BaseException], None]) -> None:
        self._on_failure = on_failure
        self._loop = asyncio.new_event_loop()
        self._tasks: set[asyncio.Task[None]] = set()
        self._thread = threading.Thread(target=self._loop.run_forever, name="gateway", daemon=True)
        self._thread.start()

    def start(self, work: Coroutine[Any, Any, None]) -> None:
        """Starts a coroutine; what ends it is reported."""
        self._loop.call_soon_threadsafe(self._start, work)

    def tell(self, function: Callable[..., object], *args: object) -> None:
        """Calls a function in the loop, soon, without waiting."""
        self._loop.call_soon_threadsafe(function, *args)

    def ask(self, function: Callable[[], T]) -> T:
        """Calls a function in the loop and returns its result.

        Raises:
            TimeoutError: if the loop does not answer.
        """

        async def call() -> T:
            return function()

        return asyncio.run_coroutine_threadsafe(call(), self._loop).result(_PATIENCE)

    def finish(self, work: Coroutine[Any, Any, None], patience: float) -> None:
        """Runs a coroutine to its end, for ``patience`` seconds at most."""
        future = asyncio.run_coroutine_threadsafe(work, self._loop)
        try:
            future.result(patience)
        except TimeoutError:
            future.cancel()

    def stop(self) -> None:
        """Ends every coroutine, the loop and the thread."""
        if not self._thread.is_alive():
            return
        self.finish(self._cancel(), _PATIENCE)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_PATIENCE)
        if not self._thread.is_alive():
            self._loop.close()

    def _start(self, work: Coroutine[Any, Any, None]) -> None:
        task = self._loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._ended)

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            self._on_failure(error)

    async def _cancel(self) -> None:
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)
        await asyncio.sleep(_CLOSING)
