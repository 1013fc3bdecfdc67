"""Processes beside this one answer in order, say why they failed, and end with the one that started them."""

import math
import operator
import os
import signal
import subprocess
import sys
import time
from functools import partial

import pytest
import torch
from flashcache.errors import ProcessEndedError
from flashcache.parallel.processes import Processes
from flashcache.parallel.shared_memory import SharedMemory

NEGATIVE = r"math domain|nonnegative"


@pytest.fixture
def three():
    with Processes(3) as processes:
        yield processes


def asked(processes: Processes, answerer, questions: list[tuple]) -> list:
    processes.give([answerer] * (processes.count - 1), SharedMemory(1))
    return processes.ask(questions, answerer)


def gone(process: int) -> bool:
    for _ in range(200):
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


def test_answers_come_in_the_order_of_the_questions_and_the_first_from_here(three):
    found = asked(three, operator.sub, [(5, 1), (5, 2), (5, 3)])
    assert found == [4, 3, 2]
    numbers = asked(three, os.getpid, [(), (), ()])
    assert numbers[0] == os.getpid()
    assert len(set(numbers)) == 3


def test_fewer_questions_than_processes_are_enough(three):
    assert asked(three, operator.neg, [(1,), (2,)]) == [-1, -2]
    assert asked(three, operator.neg, [(1,)]) == [-1]


def test_they_change_tensors_of_this_process(three):
    block = SharedMemory(256)
    values = [block.copy_of(torch.full((4,), float(number))) for number in range(3)]
    three.give([partial(operator.iadd, value) for value in values[1:]], block)
    answers = three.ask([(10.0,), (20.0,), (30.0,)], partial(operator.iadd, values[0]))
    assert [value[0].item() for value in values] == [10.0, 21.0, 32.0]
    assert answers[1].data_ptr() == values[1].data_ptr()


def test_a_later_object_takes_the_place_of_an_earlier_one(three):
    assert asked(three, operator.neg, [(1,), (2,), (3,)]) == [-1, -2, -3]
    assert asked(three, operator.inv, [(1,), (2,), (3,)]) == [-2, -3, -4]


def test_their_operations_use_one_core(three):
    assert asked(three, torch.get_num_threads, [(), (), ()])[1:] == [1, 1]


def test_what_another_process_raises_is_raised_here_and_the_next_question_is_answered(three):
    with pytest.raises(ValueError, match=NEGATIVE) as raised:
        asked(three, math.sqrt, [(4.0,), (-1.0,), (9.0,)])
    assert any("In another process" in note for note in raised.value.__notes__)
    assert three.ask([(4.0,), (16.0,), (9.0,)], math.sqrt) == [2.0, 4.0, 3.0]


def test_a_failure_here_leaves_no_answer_behind(three):
    with pytest.raises(ValueError, match=NEGATIVE):
        asked(three, math.sqrt, [(-1.0,), (16.0,), (9.0,)])
    assert three.ask([(4.0,), (25.0,), (36.0,)], math.sqrt) == [2.0, 5.0, 6.0]


def test_a_process_that_cannot_be_asked_leaves_no_answer_of_another_behind(three):
    numbers = asked(three, os.getpid, [(), (), ()])
    three.give([operator.neg] * 2, SharedMemory(1))
    os.kill(numbers[2], signal.SIGKILL)
    for _ in range(2):
        # The first time nothing may be known of its end yet.
        with pytest.raises(ProcessEndedError):
            three.ask([(1,), (2,), (3,)], operator.neg)
    assert three.ask([(4,), (5,)], operator.neg) == [-4, -5]


def test_more_questions_than_processes_are_refused(three):
    with pytest.raises(ValueError, match="longer"):
        asked(three, operator.neg, [(1,), (2,), (3,), (4,)])


def test_an_exception_that_cannot_be_sent_is_told_in_words(three):
    class UnsendableError(Exception):
        pass

    from flashcache.parallel.processes import _sendable

    found = _sendable(UnsendableError("no light"))
    assert type(found) is RuntimeError
    assert str(found) == "UnsendableError: no light"


@pytest.mark.parametrize(
    ("answerer", "argument", "words", "killed"),
    [
        (os._exit, 3, "exit code 3", False),
        (signal.raise_signal, int(signal.SIGKILL), "signal 9.*memory is short", True),
    ],
)
def test_a_process_that_ended_is_named_with_its_cause(answerer, argument, words, killed):
    with Processes(2) as two:
        two.give([answerer], SharedMemory(1))
        with pytest.raises(ProcessEndedError, match=words) as raised:
            two.ask([(1,), (argument,)], operator.neg)
        assert raised.value.was_killed is killed
        with pytest.raises(ProcessEndedError):
            two.ask([(1,), (argument,)], operator.neg)


def test_signals_to_the_whole_group_do_not_end_them(three):
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        three.give([signal.raise_signal] * 2, SharedMemory(1))
        assert three.ask([(1,), (int(number),), (int(number),)], operator.neg) == [-1, None, None]


def test_signals_that_come_while_they_load_their_libraries_do_not_end_them():
    with Processes(2) as two:
        (other,) = two._others
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            other._process.send_signal(number)
        assert asked(two, operator.neg, [(1,), (2,)]) == [-1, -2]


def test_closing_ends_them():
    with Processes(2) as two:
        number = asked(two, os.getpid, [(), ()])[1]
    assert gone(number)
    assert two.count == 1


def test_they_end_with_the_process_that_started_them():
    program = (
        "import os, time; from flashcache.parallel.processes import Processes; "
        "from flashcache.parallel.shared_memory import SharedMemory; two = Processes(2); "
        "two.give([os.getpid], SharedMemory(1)); "
        "print(two.ask([(), ()], os.getpid)[1], flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as starter:
        number = int(starter.stdout.readline())
        starter.kill()
    assert gone(number)


def test_one_process_is_this_one():
    with Processes(1) as one:
        assert one.count == 1
        assert one.ask([(2,)], operator.neg) == [-2]
