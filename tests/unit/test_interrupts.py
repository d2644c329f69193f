"""Signals that end the program, in processes of their own.

Expected: the process ends with 130, 143 or 129 and one line or none; context managers are left;
what is being published is published. In a process that is no program, handlers stay as they were.
"""

import signal
import subprocess
import sys
from functools import partial

import pytest

from inim.system.process.interrupts import cleaned_up

LINE = "inim: interrupted; unfinished results were discarded\n"
PREAMBLE = """
import os, signal, sys, threading, time
import inim.cli.main
from inim.system.process.interrupts import delayed_interrupts
from inim.cli.program import run
def interrupt(number=signal.SIGINT): os.kill(os.getpid(), number); time.sleep(0)
def say(text): os.write(1, (text + " ").encode())
def program(main): inim.cli.main.main = lambda words: main(); run()
"""


def hear() -> None:
    """Undo what shells do to jobs in the background: ignored stays ignored."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def ended(code: str, *, deaf: bool = False) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a process that runs this code."""
    process = subprocess.run(
        [sys.executable, "-c", PREAMBLE + code], capture_output=True, text=True, timeout=60,
        preexec_fn=(lambda: signal.signal(signal.SIGINT, signal.SIG_IGN)) if deaf else hear,
    )  # fmt: skip
    return process.returncode, process.stdout, process.stderr


@pytest.mark.parametrize(
    ("name", "code", "line"), [("SIGINT", 130, LINE), ("SIGTERM", 143, ""), ("SIGHUP", 129, "")]
)
def test_signal_leaves_the_blocks_and_ends_the_program(name, code, line):
    main = f"""
def main():
    try: interrupt(signal.{name}); say("went on")
    finally: say("cleaned up")
program(main)
"""
    assert ended(main) == (code, "cleaned up ", line)


def test_threads_are_not_waited_for():
    main = "def main(): threading.Thread(target=time.sleep, args=[60]).start(); interrupt()\n"
    assert ended(main + "program(main)") == (130, "", LINE)


def test_delayed_signal_comes_after_the_block():
    main = """
def main():
    with delayed_interrupts(), delayed_interrupts(): interrupt(); say("published")
    say("went on")
program(main)
"""
    assert ended(main) == (130, "published ", LINE)


def test_ignored_signals_stay_ignored():
    """Signals are ignored for jobs in a shell's background and under `nohup`."""
    main = "def main():\n    with delayed_interrupts(): interrupt()\n    interrupt(); say('on')\n"
    assert ended(main + "program(main)", deaf=True) == (0, "on ", "")


def test_an_ignored_signal_does_not_hide_another_that_was_delayed():
    main = "def main():\n    with delayed_interrupts(): interrupt(); interrupt(signal.SIGTERM)\n"
    assert ended(main + "program(main)", deaf=True) == (143, "", "")


def test_library_leaves_handlers_alone():
    code = """
import inim, inim.cli.pytest_plugin, inim.cli.program
import inim.system.worker.supervisor, inim.pipeline.launch
try:
    with delayed_interrupts(): interrupt(); say("published")
except KeyboardInterrupt: say("raised")
assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
"""
    assert ended(code) == (0, "published raised ", "")


def test_an_interrupt_in_a_callback_ends_the_program_too():
    """Python prints exceptions in callbacks, and goes on."""
    code = """
class Interrupted:
    def __del__(self): interrupt(signal.SIGHUP)
def main():
    del globals()["last"]
    say("deleted")
    time.sleep(30)
last = Interrupted()
program(main)
"""
    assert ended(code) == (129, "deleted ", "")


def test_a_block_whose_end_was_skipped_is_cleaned_up_before_those_around_it():
    """A worker that still runs must not write into a folder that is removed."""
    order: list[str] = []
    with cleaned_up(partial(order.append, "folder")):
        worker = cleaned_up(partial(order.append, "worker"))
        worker.__enter__()
    assert order == ["worker", "folder"]


#: Runs a job whose worker sleeps, in a fork for each traced step of the supervisor. Signals end the
#: fork at that step. Prints the number of steps, and those that left something.
AT_EACH_STEP = """
import contextlib, shutil, subprocess
from pathlib import Path
from inim.system.process import atomic_file, interrupts, python_process
from inim.system.worker import output, supervisor
place, numbers = Path(sys.argv[1]), [int(word) for word in sys.argv[2:]]
modules = (atomic_file, contextlib, interrupts, output, python_process, shutil, supervisor)
files = {module.__file__ for module in modules}
def write(process, messages, job, on_stage):
    (job.staging / "views").mkdir()
    return {"passed": True}
supervisor.python_module = lambda *_: ["sleep", "60"]
supervisor._carry_out = write
def trace(frame, event, _):
    global step
    step += frame.f_code.co_filename in files
    if step == wanted:
        step += 1
        for number in numbers: os.kill(os.getpid(), number)
    return trace
def main():
    sys.settrace(trace)
    supervisor.run_in_worker("module:function", dict, output.staging_folder(place / "out"))
    sys.settrace(None)
    return 7
(wanted, stride, *numbers), code, bad = numbers, 0, []
while code != 7:
    child = os.fork()
    if child == 0:
        step = 0
        os.setsid()
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        program(main)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    left = [path.name for path in place.iterdir() if path.name != "out"]
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
        left.append("worker")
    if left or code not in (7, *(128 + number for number in numbers)):
        bad.append((wanted, code, *left))
    for path in place.iterdir(): shutil.rmtree(path)
    wanted += stride
print(wanted, *bad, sep=chr(10))
"""


# In the fast tier every twelfth of about 940 steps.
@pytest.mark.parametrize("stride", [12, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("numbers", [[signal.SIGINT], [signal.SIGINT, signal.SIGTERM]])
def test_interrupt_at_any_step_of_the_supervisor_leaves_nothing(tmp_path, numbers, stride):
    words = [str(word) for word in (tmp_path, len(numbers), stride, *map(int, numbers))]
    ended = subprocess.run(
        [sys.executable, "-c", PREAMBLE + AT_EACH_STEP, *words], capture_output=True, text=True,
        preexec_fn=hear,
    )  # fmt: skip
    steps, *left = ended.stdout.splitlines()
    assert int(steps) > 300
    assert left == []
