"""Tensors in shared memory arrive as the same memory, all others as copies."""

import os
from multiprocessing import Pipe

import pytest
import torch
from flashcache.parallel.shared_memory import Channel, SharedMemory, bytes_for
from flashcache.training.parts import share_values
from torch import nn


@pytest.fixture
def ends():
    """Two ends of a connection that share a block, and the block."""
    block = SharedMemory(4096)
    one, other = (Channel(end) for end in Pipe())
    one.share(block, os.getpid())
    other.receive_block()
    yield one, other, block
    one.close()
    other.close()


def carried(ends, message):
    one, other, _ = ends
    one.send(message)
    return other.receive()


def test_a_change_at_one_end_is_seen_at_the_other(ends):
    ours = ends[2].copy_of(torch.arange(6.0).reshape(2, 3))
    theirs = carried(ends, ours)
    assert theirs.tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]
    ours[1, 2] = 7.0
    theirs[0, 0] = 8.0
    assert torch.equal(ours, theirs)
    assert ours.tolist() == [[8.0, 1.0, 2.0], [3.0, 4.0, 7.0]]


def test_what_comes_back_is_the_tensor_that_was_sent(ends):
    ours = ends[2].copy_of(torch.arange(6.0))
    one, other, _ = ends
    other.send(carried(ends, ours[2:5]))
    back = one.receive()
    back.zero_()
    assert ours.tolist() == [0.0, 1.0, 0.0, 0.0, 0.0, 5.0]


@pytest.mark.parametrize("view", [lambda t: t.T, lambda t: t[::2, 1:], lambda t: t[1], lambda t: t.flatten()])
def test_views_keep_their_shape_and_values(ends, view):
    ours = view(ends[2].copy_of(torch.arange(12.0).reshape(3, 4)))
    theirs = carried(ends, ours)
    assert torch.equal(theirs, ours)
    ours.mul_(2.0)
    assert torch.equal(theirs, ours)


def test_tensors_elsewhere_are_copied(ends):
    ours = torch.arange(6.0).reshape(2, 3).T
    theirs = carried(ends, {"values": ours, "numbers": torch.tensor([1, 2]), "none": torch.empty(0, 3)})
    assert torch.equal(theirs["values"], ours)
    assert theirs["numbers"].dtype == torch.int64
    assert theirs["none"].shape == (0, 3)
    ours.zero_()
    assert bool(theirs["values"].any())


def test_a_model_arrives_with_its_sharing_of_parameters_and_buffers(ends):
    ours = nn.Sequential(nn.Linear(3, 3), nn.BatchNorm1d(3))
    ours.append(ours[0])
    ours[1].weight.requires_grad_(False)
    for value in (*ours.parameters(), *ours.buffers()):
        value.data = ends[2].copy_of(value)
    theirs = carried(ends, ours)
    assert theirs[2] is theirs[0]
    assert isinstance(theirs[0].weight, nn.Parameter)
    assert [p.requires_grad for p in theirs.parameters()] == [p.requires_grad for p in ours.parameters()]
    with torch.no_grad():
        for value in (*ours.parameters(), ours[1].running_mean):
            value.fill_(0.25)
    assert all(bool((value == 0.25).all()) for value in (*theirs.parameters(), theirs[1].running_mean))


def test_a_block_holds_what_was_counted_and_nothing_overlaps():
    tensors = [torch.full((number,), float(number)) for number in (1, 15, 16, 17, 0, 33)]
    block = SharedMemory(bytes_for(tensors))
    copies = [block.copy_of(tensor) for tensor in tensors]
    for copy, tensor in zip(copies, tensors, strict=True):
        assert torch.equal(copy, tensor)
    with pytest.raises(AssertionError, match="too small"):
        block.zeros_like(torch.zeros(1))


def test_the_memory_outlives_its_block_and_its_file():
    tensor = SharedMemory(64).copy_of(torch.arange(4.0))
    assert tensor.sum() == 6.0


def test_no_file_stays_open():
    before = set(os.listdir("/proc/self/fd"))
    block = SharedMemory(64)
    block.close_file()
    block.close_file()
    del block
    assert set(os.listdir("/proc/self/fd")) <= before


def test_the_values_of_a_model_move_and_stay_the_same():
    model = nn.Sequential(nn.Linear(3, 2), nn.BatchNorm1d(2))
    before = {name: value.clone() for name, value in model.state_dict().items()}
    weight = model[0].weight
    block = share_values(model, 2, [weight])
    assert model[0].weight is weight
    assert all(torch.equal(value, before[name]) for name, value in model.state_dict().items())
    assert all(block.place_of(value) for value in model.state_dict().values())
    assert not any(block.zeros_like(weight).any() for _ in range(2))
