"""Ctrl-C on one of several ranks: it waits for the end of an operation that all of them have begun."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


class Interrupts:
    """Whether an interrupt may be raised now.

    A rank that leaves a collective operation half-way lets the others wait for ever. So while one is under way, an
    interrupt is only noted; it is raised where the rank can tell the others of it.
    """

    def __init__(self) -> None:
        self._depth = self._holds = 0
        self._is_noted = self._is_raised = False
        self._before: Any = None

    @contextmanager
    def taken(self) -> Iterator[None]:
        """A call, in which interrupts wait until `allow`, and where they are held; only the main thread gets any.

        At most one is raised in a call, so that an error on its way to the other ranks is not lost; what comes after it
        is noted, too.
        """
        before = signal.getsignal(signal.SIGINT)
        if self._depth or not callable(before) or threading.current_thread() is not threading.main_thread():
            holds, self._holds = self._holds, 1
            try:
                yield
            finally:
                self._holds = holds
            return

        def handle(number: int, frame: FrameType | None) -> None:
            if self._holds or self._is_raised:
                self._is_noted = True
            else:
                self._raise(number, frame)

        self._depth, self._holds, self._is_noted, self._is_raised, self._before = 1, 1, False, False, before
        signal.signal(signal.SIGINT, handle)
        try:
            yield
        except KeyboardInterrupt:
            self._is_noted = False  # one stands for all
            raise
        finally:
            self._depth = 0
            signal.signal(signal.SIGINT, before)
            if self._is_noted:
                before(signal.SIGINT, None)

    def _raise(self, number: int, frame: FrameType | None) -> None:
        """Do what the program does at an interrupt, which need not be an exception."""
        self._is_noted, self._is_raised = False, True
        self._before(number, frame)
        self._is_raised = False

    def allow(self) -> None:
        """From now on interrupts are raised, with one that has come since the call began."""
        self.release()
        if self._is_noted and self._holds == 0:
            self._raise(signal.SIGINT, None)

    def hold(self) -> None:
        """From now on interrupts wait."""
        self._holds += 1

    def release(self) -> None:
        """They wait no longer than those that were to wait before."""
        self._holds -= 1

    @contextmanager
    def held(self) -> Iterator[None]:
        """A block at whose end, if it ends well, an interrupt is raised that has come meanwhile."""
        self.hold()
        try:
            yield
        finally:
            self.release()
        if self._is_noted and self._holds == 0:
            self._raise(signal.SIGINT, None)
