from hypothesis import given
from hypothesis import strategies as st
from lambent_server.executors.rooms import ClusterRoom, LocalRoom, Needs


def nodes(*resources: tuple[float, float, float]) -> dict[str, dict[str, float]]:
    names = ("CPU", "GPU", "memory")
    return {f"n{at}": dict(zip(names, given, strict=True)) for at, given in enumerate(resources)}


def test_a_machine_gives_each_gpu_and_each_place_once():
    room = LocalRoom(3, [1, 2, 5])
    assert room.most_gpus() == 3
    assert room.take(2) == (1, 2)
    assert room.most_gpus() == 1
    assert room.take(0) == ()
    assert room.take(1) == (5,)
    assert room.most_gpus() is None


def test_a_job_can_have_the_gpus_of_one_node_only():
    room = ClusterRoom(nodes((8, 2, 0), (8, 3, 0)), 1.0, 0)
    assert room.most_gpus() == 3
    room.take(3)
    assert room.most_gpus() == 2
    room.take(2)
    assert room.most_gpus() == 0


def test_small_jobs_do_not_break_up_the_largest_node():
    room = ClusterRoom(nodes((8, 8, 0), (8, 1, 0)), 1.0, 0)
    room.take(1)
    room.take(0)
    assert room.most_gpus() == 8


def test_runs_need_processors_and_memory_besides_gpus():
    assert ClusterRoom(nodes((1, 4, 100)), 2.0, 0).most_gpus() is None
    assert ClusterRoom(nodes((4, 4, 100)), 2.0, 101).most_gpus() is None
    room = ClusterRoom(nodes((4, 4, 100)), 2.0, 60)
    assert room.most_gpus() == 4
    room.take(1)
    assert room.most_gpus() is None


def test_what_others_use_of_the_cluster_is_not_free():
    room = ClusterRoom(nodes((4, 2, 0), (4, 2, 0)), 1.0, 0)
    room.limit({"CPU": 2.0, "GPU": 1.0})
    assert room.most_gpus() == 1
    room.take(0)
    room.take(0)
    assert room.most_gpus() is None


def test_a_run_on_a_node_uses_that_node_and_one_without_any_node():
    room = ClusterRoom(nodes((2, 2, 0), (2, 0, 0)), 1.0, 0)
    room.use("n0", Needs(cpus=1.0, gpus=2, memory_bytes=0))
    room.use("gone", Needs(cpus=1.0, gpus=2, memory_bytes=0))
    assert room.most_gpus() == 0
    for _ in range(3):
        room.use_somewhere(Needs(cpus=1.0, gpus=0, memory_bytes=0))
    assert room.most_gpus() is None


def test_runs_ahead_may_be_started_without_room():
    room = ClusterRoom({}, 1.0, 0)
    assert room.most_gpus() is None
    room.allow_ahead(2)
    room.take(8)
    assert room.most_gpus() is not None
    room.take(0)
    assert room.most_gpus() is None


@given(
    st.lists(st.tuples(st.integers(0, 8), st.integers(0, 8), st.integers(0, 8)), max_size=4),
    st.integers(1, 3),
    st.integers(0, 3),
    st.lists(st.integers(0, 8), max_size=30),
)
def test_no_more_is_given_than_there_is(
    given_nodes: list[tuple[int, int, int]], cpus: int, memory: int, wanted: list[int]
):
    room = ClusterRoom(nodes(*given_nodes), float(cpus), memory)
    taken = []
    for gpus in wanted:
        most = room.most_gpus()
        if most is not None and gpus <= most:
            room.take(gpus)
            taken.append(gpus)
    assert sum(taken) <= sum(gpus for _, gpus, _ in given_nodes)
    assert len(taken) <= sum(c // cpus for c, _, _ in given_nodes)
    if memory:
        assert len(taken) <= sum(m // memory for _, _, m in given_nodes)
