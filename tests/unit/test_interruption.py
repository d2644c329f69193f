"""What ends the program when a signal comes, in processes of their own.

Expected: wherever Python is, the process ends with 130 or 143 and one line or none; what is half
done is undone, newest first; what is being published is published. In a process that is no program,
handlers stay as they were.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

LINE = "inim: interrupted; nothing was written\n"
PREAMBLE = """
import os, signal, sys, threading, time
from inim.process import interruption
from inim.process.interruption import publishing, undone_afterwards
def interrupt(number=signal.SIGINT): os.kill(os.getpid(), number); time.sleep(0)
def say(text): os.write(1, (text + " ").encode())
def temporary(name): return undone_afterwards(lambda: name, lambda name: say("undone " + name))
"""


def hear() -> None:
    """Undo what shells do to jobs in the background: ignored stays ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def ended(code: str, *, installed: bool = True, deaf: bool = False) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a process that runs this code."""
    words = PREAMBLE + ("interruption.install()\n" if installed else "") + code
    done = subprocess.run(
        [sys.executable, "-c", words], capture_output=True, text=True, timeout=60,
        preexec_fn=(lambda: signal.signal(signal.SIGINT, signal.SIG_IGN)) if deaf else hear,
    )  # fmt: skip
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(
    "code",
    [
        "interrupt(); say('went on')",
        "class A:\n    def __del__(self): interrupt()\na = A(); del a; say('went on')",
        "import weakref\nclass A: pass\na = A(); r = weakref.ref(a, lambda _: interrupt())\n"
        "del a; say('went on')",
        "import ctypes\nctypes.CFUNCTYPE(None)(interrupt)(); say('went on')",
        "try: interrupt()\nexcept BaseException: pass\nsay('went on')",
        "sys.setprofile(lambda *_: None); sys.settrace(lambda *_: interrupt())\nsay('a'); say('b')",
    ],
)
def test_interrupt_is_never_swallowed(code: str) -> None:
    code, out, err = ended(code)
    assert (code, err) == (130, LINE)
    assert "went on" not in out


def test_sigterm_is_quiet() -> None:
    assert ended("interrupt(signal.SIGTERM)") == (143, "", "")


def test_what_is_half_done_is_undone_newest_first() -> None:
    code = "with temporary('a'), temporary('b'):\n    with temporary('c'): pass\n    interrupt()"
    assert ended(code) == (130, "undone c undone b undone a ", LINE)


def test_an_undoing_that_fails_does_not_keep_others() -> None:
    code = "with temporary('a'), undone_afterwards(lambda: 0, lambda _: 1 / 0): interrupt()"
    assert ended(code) == (130, "undone a ", LINE)


def test_what_is_just_made_is_undone() -> None:
    code = "def make(): interrupt(); say('made'); return 'a'\n"
    code += "with undone_afterwards(make, lambda a: say('undone ' + a)): say('went on')"
    assert ended(code) == (130, "made undone a ", LINE)


def test_what_another_thread_just_makes_is_undone_and_it_makes_nothing_more() -> None:
    code = """
begun = threading.Event()
def make(): begun.set(); time.sleep(0.3); say("made"); return "a"
def work():
    while True:
        with undone_afterwards(make, lambda a: say("undone " + a)): pass
threading.Thread(target=work, daemon=True).start()
begun.wait(); interrupt()
"""
    code, out, err = ended(code)
    assert (code, err) == (130, LINE)
    assert out.count("made") == 1
    assert out.startswith("made undone a ")


def test_what_is_published_is_published_and_the_line_does_not_deny_it() -> None:
    code = "with publishing():\n    interrupt()\n    say('published')\nsay('went on')"
    assert ended(code) == (130, "published ", "inim: interrupted\n")
    code = "with publishing(): say('published')\ninterrupt()"
    assert ended(code) == (130, "published ", "inim: interrupted\n")


def test_publishing_that_fails_ends_the_program_all_the_same() -> None:
    code = "with publishing():\n    interrupt()\n    raise OSError"
    assert ended(code) == (130, "", "inim: interrupted\n")


def test_block_that_does_not_end_is_not_waited_for_for_ever() -> None:
    """A lock whose holder was stopped, say; the alarm is set to half a second here."""
    code = "interruption.WAIT_S = 0.5\nwith temporary('a'), publishing():\n"
    code += "    interrupt()\n    time.sleep(60)"
    assert ended(code) == (130, "undone a ", "inim: interrupted\n")


def test_own_words_stay() -> None:
    code = "interruption.say('results are kept')\nwith publishing(): pass\ninterrupt()"
    assert ended(code) == (130, "", "inim: interrupted; results are kept\n")


def test_second_interrupt_does_not_cut_the_undoing_short() -> None:
    code = "with undone_afterwards(lambda: 0, lambda _: (interrupt(), say('undone'))): interrupt()"
    assert ended(code) == (130, "undone ", LINE)


def test_ignored_signals_stay_ignored() -> None:
    """As for jobs of a shell's background, and below `nohup`."""
    assert ended("interrupt(); say('went on')", deaf=True) == (0, "went on ", "")


def test_library_leaves_handlers_alone_and_undoes_all_the_same() -> None:
    code = """
import inim, inim.pytest_plugin, inim.worker.supervisor, inim.pipeline.validation, inim.program
assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
try:
    with temporary("a"), publishing(): interrupt()
except KeyboardInterrupt: say("raised")
"""
    assert ended(code, installed=False) == (0, "undone a raised ", "")


def test_child_does_not_hear_the_terminal_and_ends_with_the_program() -> None:
    code = """
from inim.process.python_process import python_code, started
hears = "import os, signal, time; os.kill(os.getpid(), signal.SIGINT); print('here', flush=True)"
import subprocess
with started(python_code(hears + "; time.sleep(60)"), stdout=subprocess.PIPE) as child:
    say(child.stdout.readline().decode().strip()); say(str(child.pid)); interrupt()
"""
    code, out, err = ended(code)
    assert (code, err, out.split()[0]) == (130, LINE, "here")
    with pytest.raises(ProcessLookupError):
        os.kill(int(out.split()[1]), 0)
