"""Space for bodies under way: together they never pass the floor, and none takes what others need."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from lambent_server.api.problems import Problem
from lambent_server.storage.disk_space import RUNS_PART, Allowance, Space


class Disk:
    """A disk that a test fills."""

    def __init__(self, free: int) -> None:
        self.free = free
        self.least = free
        self.lock = threading.Lock()

    def write(self, size: int) -> None:
        """Use space."""
        with self.lock:
            self.free -= size
            self.least = min(self.least, self.free)


def refused(code: str) -> "pytest.RaisesExc[Problem]":
    return pytest.raises(Problem, check=lambda problem: problem.code == code)


def test_bodies_that_arrive_at_once_never_pass_the_floor() -> None:
    disk = Disk(10_000)
    space = Space(lambda: disk.free, floor_bytes=2_000, tenant_share=0.9)

    def send(number: int) -> bool:
        try:
            with space.body(f"tenant {number}") as body:
                for _ in range(50):
                    with body.writing(37):
                        disk.write(37)
        except Problem:
            return False
        return True

    with ThreadPoolExecutor(12) as pool:
        done = list(pool.map(send, range(12)))
    assert disk.least >= 2_000
    assert 2 <= sum(done) < 12


def test_what_is_being_written_counts_before_the_disk_has_it() -> None:
    space = Space(lambda: 1_000, floor_bytes=200, tenant_share=1.0)
    with space.taking(500):
        with refused("disk_floor"), space.taking(301):
            pass
        with space.taking(300):
            pass
    with space.taking(800):
        pass


def test_the_bodies_of_one_tenant_leave_half_of_the_space_to_others() -> None:
    disk = Disk(1_200)
    space = Space(lambda: disk.free, floor_bytes=200, tenant_share=0.5)
    with space.body("a") as first, space.body("a") as second:
        for body in (first, second):
            with body.writing(250):
                disk.write(250)
        with refused("uploads_share"), first.writing(1):
            pass
        with space.body("b") as other, other.writing(500):
            disk.write(500)
    # What was under way is stored now, or gone: none of it counts any more.
    disk.free = 1_200
    with space.body("a") as third, third.writing(500):
        pass


def test_an_announced_body_that_has_no_room_is_refused_and_keeps_none() -> None:
    space = Space(lambda: 1_000, floor_bytes=0, tenant_share=0.5)
    with space.body("a") as body:
        with refused("uploads_share"):
            body.expect(501)
        body.expect(500)
        with space.body("b") as other:
            other.expect(500)


def test_all_bodies_of_a_tenant_count_for_its_quota_while_they_arrive() -> None:
    space = Space(lambda: 10_000, floor_bytes=0, tenant_share=1.0)
    allowance = Allowance(bytes=100, refuse=lambda held: Problem(507, "quota_bytes", f"{held} bytes"))
    with space.body("a", allowance=allowance) as first, space.body("a", allowance=allowance) as second:
        with first.writing(60):
            pass
        with refused("quota_bytes"), second.writing(41):
            pass
        with second.writing(40):
            pass
        with space.body("b", allowance=allowance) as other, other.writing(100):
            pass


def test_runs_may_use_half_of_the_floor_and_need_no_share() -> None:
    space = Space(lambda: 1_000, floor_bytes=1_200, tenant_share=0.1)
    with refused("disk_floor"):
        space.require()
    with space.body("a", floor_part=RUNS_PART) as body:
        with body.writing(400):
            pass
        with refused("disk_floor"), body.writing(401):
            pass
