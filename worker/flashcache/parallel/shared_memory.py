"""Memory that several processes share, and messages between them that refer to tensors in it.

A tensor in shared memory travels as its place there, and arrives as the same memory; any other tensor travels
as a copy. Messages are pickles: they go only to a process that this one started, over a socket of its own.
"""

import io
import mmap
import os
import pickle
import tempfile
from collections.abc import Iterable
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle, send_handle
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

_ALIGNMENT = 64


def bytes_for(tensors: Iterable[Tensor]) -> int:
    """Return the size of a block that holds copies of `tensors`, in bytes."""
    return sum(_aligned(tensor.numel() * tensor.element_size()) for tensor in tensors)


class SharedMemory:
    """A block of memory that other processes can map. It exists while any of them has a tensor in it."""

    def __init__(self, num_bytes: int, descriptor: int | None = None) -> None:
        """Make a block of zeros, or map the one behind the file `descriptor`, which is then ours to close."""
        self.num_bytes = max(num_bytes, 1)
        self.descriptor = _new_file(self.num_bytes) if descriptor is None else descriptor
        self._map = mmap.mmap(self.descriptor, self.num_bytes)
        self._start = torch.frombuffer(self._map, dtype=torch.uint8, count=1).data_ptr()
        self._used = 0

    def copy_of(self, tensor: Tensor) -> Tensor:
        """Return a copy of a CPU tensor in this block, contiguous."""
        copy = self.zeros_like(tensor)
        copy.copy_(tensor.detach())
        return copy

    def zeros_like(self, tensor: Tensor) -> Tensor:
        """Return a new tensor of zeros in this block, contiguous, of the shape and type of `tensor`."""
        offset, self._used = self._used, self._used + _aligned(tensor.numel() * tensor.element_size())
        assert self._used <= self.num_bytes, "the block was made too small"
        return self.at(_Place(offset, tensor.dtype, tensor.shape, torch.empty(tensor.shape).stride()))

    def place_of(self, tensor: Tensor) -> "_Place | None":
        """Return where in this block a tensor lies, None for one that does not."""
        offset = tensor.data_ptr() - self._start
        if tensor.device.type != "cpu" or not tensor.numel() or not 0 <= offset < self.num_bytes:
            return None
        return _Place(offset, tensor.dtype, tensor.shape, tensor.stride())

    def at(self, place: "_Place") -> Tensor:
        """Return the tensor at a place of this block."""
        if not place.shape.numel():
            return torch.empty(place.shape, dtype=place.dtype)
        last = sum((size - 1) * step for size, step in zip(place.shape, place.stride, strict=True))
        flat = torch.frombuffer(self._map, dtype=place.dtype, count=last + 1, offset=place.offset)
        return flat.as_strided(place.shape, place.stride)

    def close_file(self) -> None:
        """Close the descriptor: no other process can map the block any more, but the memory stays."""
        if self.descriptor >= 0:
            os.close(self.descriptor)
            self.descriptor = -1


class _Place(NamedTuple):
    """A tensor's place in a block of shared memory."""

    offset: int
    """Bytes."""
    dtype: torch.dtype
    shape: torch.Size
    stride: tuple[int, ...]


class Channel:
    """One end of the connection between two processes."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._block: SharedMemory | None = None

    def send(self, message: Any) -> None:
        """Send a message; raises `OSError` where the other process is gone."""
        buffer = io.BytesIO()
        _Pickler(buffer, self._block).dump(message)
        self._connection.send_bytes(buffer.getbuffer())

    def receive(self) -> Any:
        """Return the next message; raises `EOFError` or `OSError` where the other process is gone."""
        return _Unpickler(io.BytesIO(self._connection.recv_bytes()), self._block).load()

    def share(self, block: SharedMemory, process: int) -> None:
        """Let the other end, in the process with this number, map a block: instead of an earlier one."""
        self.send(block.num_bytes)
        send_handle(self._connection, block.descriptor, process)
        self._block = block

    def receive_block(self) -> None:
        """Map the block that the other end shares, instead of an earlier one."""
        num_bytes = self.receive()
        self._block = SharedMemory(num_bytes, recv_handle(self._connection))
        self._block.close_file()

    def close(self) -> None:
        """Close this end; the other one sees it."""
        self._connection.close()


class _Pickler(pickle.Pickler):
    """Writes tensors of a block as their places, and others as copies."""

    def __init__(self, file: io.BytesIO, block: SharedMemory | None) -> None:
        super().__init__(file, protocol=pickle.HIGHEST_PROTOCOL)
        self._block = block

    def persistent_id(self, value: Any) -> Any:
        """Return what stands for a tensor of the block, None for everything else."""
        if not isinstance(value, Tensor) or self._block is None:
            return None
        place = self._block.place_of(value)
        if place is None:
            return None
        return id(value), place, isinstance(value, nn.Parameter), value.requires_grad

    def reducer_override(self, value: Any) -> Any:
        """Write a plain tensor through numpy, several times faster than torch's own way."""
        if type(value) is Tensor and value.device.type == "cpu" and not value.requires_grad:
            return torch.from_numpy, (value.contiguous().numpy(),)
        return NotImplemented


class _Unpickler(pickle.Unpickler):
    """Reads what `_Pickler` writes; a tensor that was met twice stays one tensor."""

    def __init__(self, file: io.BytesIO, block: SharedMemory | None) -> None:
        super().__init__(file)
        self._block = block
        self._known: dict[int, Tensor] = {}

    def persistent_load(self, reference: Any) -> Tensor:
        """Return the tensor of the block that `reference` stands for."""
        key, place, is_parameter, with_gradient = reference
        if key not in self._known:
            assert self._block is not None
            tensor = self._block.at(place)
            self._known[key] = nn.Parameter(tensor, with_gradient) if is_parameter else tensor
        return self._known[key]


def _aligned(num_bytes: int) -> int:
    return -(-num_bytes // _ALIGNMENT) * _ALIGNMENT


def _new_file(num_bytes: int) -> int:
    """Return the descriptor of a nameless file of this size, in memory where the system can do that.

    Not in /dev/shm, which containers limit to 64 MB.
    """
    if hasattr(os, "memfd_create"):
        descriptor = os.memfd_create("lambent")
    else:
        with tempfile.TemporaryFile() as file:
            descriptor = os.dup(file.fileno())
    os.ftruncate(descriptor, num_bytes)
    return descriptor
