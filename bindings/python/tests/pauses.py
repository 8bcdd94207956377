"""Repeats a test that failed while the computer paused.

A driver or a stream takes a gripper for lost after such a pause. Without a pause, a failure counts at once.
"""

from __future__ import annotations

import threading
import time

import pytest
from _pytest.runner import runtestprotocol

PAUSE = 0.1
"""Shortest pause in s that excuses a failure. A driver tolerates 0.6 s without an answer, and each thread pauses for a time of its own."""

TRIES = 8

PERIOD = 0.02


class _Watch(threading.Thread):
    """Measures how late this process continues after a sleep."""

    longest = 0.0

    def run(self) -> None:
        while True:
            begin = time.monotonic()
            time.sleep(PERIOD)
            self.longest = max(self.longest, time.monotonic() - begin - PERIOD)


_watch = _Watch(daemon=True)


def pytest_runtest_protocol(item: pytest.Function, nextitem: pytest.Item | None) -> bool:
    """Run a test, again with new fixtures after a failure beside a pause."""
    if not _watch.is_alive():
        _watch.start()
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for _ in range(TRIES):
        _watch.longest = 0.0
        reports = runtestprotocol(item, nextitem=nextitem, log=False)
        if not any(report.failed for report in reports) or _watch.longest < PAUSE:
            break
        item._initrequest()
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True
