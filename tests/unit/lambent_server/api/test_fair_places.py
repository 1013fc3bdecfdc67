"""Places for long work: whoever queues most waits most, and nobody waits for someone else's queue."""

import asyncio
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from lambent_server.api.fair_places import FairPlaces


class Work:
    """Pieces of work that end when a test says so."""

    def __init__(self, places: FairPlaces) -> None:
        self.places = places
        self.begun: list[str] = []
        self.tasks: dict[str, asyncio.Task[None]] = {}
        self.ends: dict[str, asyncio.Event] = {}

    async def add(self, name: str, tenant: str, client: str = "key") -> None:
        """Ask for a place."""
        self.ends[name] = asyncio.Event()

        async def act() -> None:
            async with self.places.place(tenant, client):
                self.begun.append(name)
                await self.ends[name].wait()

        self.tasks[name] = asyncio.create_task(act())
        await asyncio.sleep(0)
        await asyncio.sleep(0)

    async def end(self, name: str) -> None:
        """End a piece of work that has begun."""
        self.ends[name].set()
        await self.tasks[name]
        await asyncio.sleep(0)
        await asyncio.sleep(0)

    async def cancel(self, name: str) -> None:
        """Break a piece of work off, which may still be waiting."""
        self.tasks[name].cancel()
        await asyncio.gather(self.tasks[name], return_exceptions=True)
        await asyncio.sleep(0)


def test_a_tenant_and_a_client_have_their_shares_and_others_pass_by() -> None:
    async def act() -> None:
        work = Work(FairPlaces(8, tenant_share=0.5, client_share=0.25))
        for number in range(6):
            await work.add(f"a{number}", "a", f"key {number % 3}")
        assert work.begun == ["a0", "a1", "a2", "a3"]
        for number in range(3):
            await work.add(f"b{number}", "b")
        assert work.begun[4:] == ["b0", "b1"]
        await work.end("b0")
        assert work.begun[6:] == ["b2"]
        for name in (*work.begun, *work.tasks):
            await work.end(name)
        assert len(work.begun) == 9

    asyncio.run(act())


def test_tenants_take_turns_however_long_the_queue_of_one_is() -> None:
    async def act() -> None:
        work = Work(FairPlaces(1, tenant_share=1.0, client_share=1.0))
        for number in range(5):
            await work.add(f"a{number}", "a")
        await work.add("b0", "b")
        await work.add("b1", "b")
        await work.add("c0", "c")
        while len(work.begun) < 8:
            await work.end(work.begun[-1])
        await work.end(work.begun[-1])
        assert work.begun == ["a0", "b0", "c0", "a1", "b1", "a2", "a3", "a4"]

    asyncio.run(act())


def test_clients_of_a_tenant_take_turns() -> None:
    async def act() -> None:
        work = Work(FairPlaces(1, tenant_share=1.0, client_share=1.0))
        for name in ("x0", "x1", "x2", "y0"):
            await work.add(name, "a", name[0])
        while len(work.begun) < 4:
            await work.end(work.begun[-1])
        await work.end(work.begun[-1])
        assert work.begun == ["x0", "y0", "x1", "x2"]

    asyncio.run(act())


@pytest.mark.parametrize("waits", [True, False])
def test_a_request_that_was_broken_off_leaves_its_place_to_the_next(waits: bool) -> None:
    async def act() -> None:
        work = Work(FairPlaces(1, tenant_share=1.0, client_share=1.0))
        for name in "abc":
            await work.add(name, name)
        await work.cancel("b" if waits else "a")
        if waits:
            await work.end("a")
            assert work.begun == ["a", "c"]
        else:
            assert work.begun == ["a", "b"]

    asyncio.run(act())


@given(st.lists(st.tuples(st.sampled_from("abc"), st.sampled_from("xy"), st.booleans()), max_size=30))
def test_whatever_is_broken_off_no_place_is_lost(asked: list[tuple[str, str, bool]]) -> None:
    async def act() -> None:
        places = FairPlaces(3, tenant_share=0.5, client_share=0.25)
        work = Work(places)
        for number, (tenant, client, breaks) in enumerate(asked):
            await work.add(str(number), tenant, client)
            if breaks:
                await work.cancel(str(number // 2))
        for task in work.tasks.values():
            task.cancel()
        await asyncio.gather(*work.tasks.values(), return_exceptions=True)
        after = Work(places)
        for name in "pqr":
            await after.add(name, name)
        assert after.begun == ["p", "q", "r"]
        for name in "pqr":
            await after.end(name)

    asyncio.run(act())


def test_work_runs_in_threads_of_its_own() -> None:
    async def act() -> str:
        places = FairPlaces(1, tenant_share=1.0, client_share=1.0)
        name: Callable[[str], str] = str.upper
        return await places.run("a", "key", name, "done")

    assert asyncio.run(act()) == "DONE"
