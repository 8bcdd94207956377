"""The programs ``wsg`` and ``wsg-sim``, in this process."""

import signal
import sys

from . import _native


def _take_over_signals() -> None:
    """Let the program handle Ctrl-C itself."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def wsg() -> None:
    _take_over_signals()
    sys.exit(_native.run_wsg(["wsg", *sys.argv[1:]]))


def wsg_sim() -> None:
    _take_over_signals()
    sys.exit(_native.run_wsg_sim(["wsg-sim", *sys.argv[1:]]))
