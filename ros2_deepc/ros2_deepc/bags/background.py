# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Writes a bag in a thread of its own, so that a slow or full disk never holds up the loop that is recorded."""

import threading
import time
from collections import deque
from collections.abc import Callable

from .writer import BagWriter

_PERIOD = 0.2  # [s] between two looks at what waits; many messages at once cost less than one at a time
_HURRY = 0.25  # share of the capacity at which the thread is woken before that
_TURN = 1e-3  # [s] of writing after which the loop may run; handing over costs as much as writing a few messages
_OVERHEAD = 300  # bytes of memory that a waiting message takes beside its own
_Job = Callable[[BagWriter], None]


class BackgroundWriter:
    """A bounded queue in front of a ``BagWriter``.

    The order of calls is kept. Memory is bounded by ``capacity``: a message that finds no room is counted in ``lost``
    and dropped, after a wait of at most ``patience``. An error of the disk ends the writing, not the caller: it is kept
    in ``failure``, and what comes after it is lost, too.

    Args:
        writer: the bag; nobody else may use it until ``stop``.
        capacity: bytes that may wait for the disk.

    Attributes:
        lost: messages (and other calls) that were dropped.
        failure: one line on why writing ended; empty while all is well.
    """

    def __init__(self, writer: BagWriter, capacity: int) -> None:
        self._writer, self._capacity = writer, capacity
        self._waiting: deque[tuple[int, _Job]] = deque()
        self._size = 0  # bytes that wait or are being written
        self._change = threading.Condition()
        self._stopping = False
        self.lost = 0
        self.failure = ""
        self._thread = threading.Thread(target=self._run, name="bag writer", daemon=True)
        self._thread.start()

    def write(self, topic: str, data: bytes, log_time: int, *, patience: float = 0.0) -> bool:
        """Queues one message.

        Args:
            topic: registered by an earlier ``call`` of ``add_topic``.
            data: serialized message.
            log_time: [ns].
            patience: longest wait for room [s].

        Returns:
            Whether there was room.
        """
        size = len(data) + _OVERHEAD
        with self._change:
            if self._size + size > self._capacity and not self._room(size, patience):
                self.lost += 1
                return False
            self._append(size, lambda writer: writer.write(topic, data, log_time))
        return True

    def call(self, job: _Job) -> None:
        """Queues any other use of the writer, at its place in the order; it always finds room."""
        with self._change:
            self._append(_OVERHEAD, job)

    def stop(self) -> BagWriter:
        """Waits until all is written, ends the thread and gives the writer back; a second call does nothing more."""
        with self._change:
            self._stopping = True
            self._change.notify_all()
        self._thread.join()
        return self._writer

    def _append(self, size: int, job: _Job) -> None:
        if self.failure:
            self.lost += 1
            return
        self._waiting.append((size, job))
        self._size += size
        if self._size > _HURRY * self._capacity:
            self._change.notify_all()

    def _room(self, size: int, patience: float) -> bool:
        self._change.notify_all()
        return self._change.wait_for(lambda: self._size + size <= self._capacity or bool(self.failure), patience)

    def _run(self) -> None:
        while self._take_turn():
            pass

    def _take_turn(self) -> bool:
        """Writes what has come since the last turn; False once all is done."""
        with self._change:
            if not self._stopping and self._size <= _HURRY * self._capacity:
                self._change.wait(_PERIOD)
            batch, self._waiting = self._waiting, deque()
            ending = self._stopping
        try:
            self._write(batch)
        except Exception as error:  # the disk's, or a bug: either way the caller goes on and must be told
            self._give_up(error, len(batch))
        return not (ending and not self._waiting)

    def _write(self, batch: deque[tuple[int, _Job]]) -> None:
        while batch:
            written, since = 0, time.perf_counter()
            while batch and time.perf_counter() - since < _TURN:
                size, job = batch[0]
                job(self._writer)
                batch.popleft()
                written += size
            time.sleep(0)  # hands the interpreter to the loop, which would wait for it up to 5 ms otherwise
            with self._change:
                self._size -= written
                self._change.notify_all()
        self._writer.flush_if_due()

    def _give_up(self, error: Exception, unwritten: int) -> None:
        with self._change:
            self.failure = self.failure or (str(error) if isinstance(error, OSError) else repr(error))
            self.lost += unwritten + len(self._waiting)
            self._waiting.clear()
            self._size = 0
            self._change.notify_all()
