"""Ranks: processes that divide each batch of a training among them, with a device each (torch.distributed).

Every rank has the whole model. Row i of what one process would compute on a whole batch belongs to rank
i mod `count`; rows that follow from it, such as several points of a ray, belong to the same rank. Random
numbers of rows are drawn for the whole batch on every rank (`flashcache.randomness`), and means over rows
that count divide by the number in the whole batch (`flashcache.rows`). So the mean of the ranks' losses is
the loss of one process that has the whole batch, and the sum of their gradients is its gradient, up to
rounding. Shapes must be fixed, so that all ranks draw alike (decision 0029).
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import timedelta
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor, nn

from flashcache.errors import RankLostError

AGREEMENT_TIMEOUT_S = 48 * 3600.0
"""Time that ranks wait between steps for the first, which may wait a day for a server that is unavailable."""
_ALIGNMENT = 64
_LOOPBACK = "lo" if os.uname().sysname == "Linux" else "lo0"


class Ranks:
    """This process as one of several ranks; every method but `close` is called by all of them alike.

    Methods raise `RankLostError` where another rank is gone or does not answer.
    """

    def __init__(self, number: int, count: int, control: Any = None) -> None:
        """`control` is what ranks agree by between steps; by default that of their sums."""
        self.number, self.count = number, count
        self._control = control

    @classmethod
    def join(
        cls,
        number: int,
        count: int,
        meeting: Path,
        device: torch.device,
        *,
        step_timeout_s: float,
    ) -> "Ranks":
        """Meet the other ranks over the file `meeting`, which no ranks have met over before.

        Within a step a rank waits `step_timeout_s` for the others before it takes them for lost.

        They find each other by a file, and talk over the loopback interface: torch's own meeting point
        listens on all interfaces, to everyone. NCCL adds on GPUs, gloo on processors.
        """
        for name in ("GLOO_SOCKET_IFNAME", "NCCL_SOCKET_IFNAME"):
            os.environ.setdefault(name, _LOOPBACK)
        on_gpu = device.type == "cuda"
        if on_gpu:
            torch.cuda.set_device(device)
        with _telling_of_loss():
            dist.init_process_group(
                "nccl" if on_gpu else "gloo",
                store=dist.FileStore(str(meeting), count),  # type: ignore[attr-defined]  # the stub lacks it
                rank=number,
                world_size=count,
                timeout=timedelta(seconds=step_timeout_s),
            )
            control = dist.new_group(backend="gloo", timeout=timedelta(seconds=AGREEMENT_TIMEOUT_S))
        return cls(number, count, control)

    def close(self) -> None:
        """Leave the other ranks."""
        dist.destroy_process_group()

    def add(self, values: Tensor) -> Tensor:
        """Replace `values` by their sum over the ranks, the same bits on each, and return them."""
        with _telling_of_loss():
            dist.all_reduce(values)
        return values

    def rows_of_all(self, values: Tensor) -> Tensor:
        """Return the rows of all ranks in the order of the whole batch; no gradients."""
        own = values.detach().contiguous()
        gathered = [torch.empty_like(own) for _ in range(self.count)]
        with _telling_of_loss():
            dist.all_gather(gathered, own)
        return torch.stack(gathered, dim=1).flatten(0, 1)

    def agree(self, *numbers: int) -> tuple[int, ...]:
        """Return the numbers that the first rank gives; what others give is ignored. All wait for it."""
        agreed = torch.tensor(numbers, dtype=torch.int64)
        with _telling_of_loss():
            dist.broadcast(agreed, 0, group=self._control)
        return tuple(agreed.tolist())

    def hold_the_same(self, module: nn.Module) -> bool:
        """Return whether the values of a module are the same bits on all ranks."""
        own = torch.stack([_bits(value) for value in module.state_dict().values()])
        digests = [torch.empty_like(own) for _ in range(self.count)]
        with _telling_of_loss():
            dist.all_gather(digests, own, group=self._control)
        return all(torch.equal(digests[0], other) for other in digests[1:])


_CURRENT: ContextVar[Ranks | None] = ContextVar("ranks", default=None)


@contextmanager
def divided_among(ranks: Ranks | None) -> Iterator[None]:
    """Let rows be this rank's share of a batch (`own_count`, `flashcache.randomness`, ...); None: all."""
    before = _CURRENT.set(ranks)
    try:
        yield
    finally:
        _CURRENT.reset(before)


class Bucket:
    """The gradients of parameters in one piece of memory, so that ranks add them with one call."""

    def __init__(self, ranks: Ranks, parameters: Sequence[nn.Parameter]) -> None:
        """The parameters that have a gradient get one in the bucket, with its values."""
        self._ranks = ranks
        moving = [parameter for parameter in parameters if parameter.grad is not None]
        sizes = [_ALIGNMENT * -(-parameter.numel() // _ALIGNMENT) for parameter in moving]
        first = moving[0]
        assert all((p.dtype, p.device) == (first.dtype, first.device) for p in moving), "one kind of values"
        self._flat = torch.zeros(sum(sizes), dtype=first.dtype, device=first.device)
        for parameter, place in zip(moving, self._flat.split(sizes), strict=True):
            assert parameter.grad is not None
            inside = place[: parameter.numel()].view(parameter.shape)
            parameter.grad = inside.copy_(parameter.grad)

    def add(self) -> None:
        """Replace the gradients by their sums over the ranks."""
        self._ranks.add(self._flat)


def is_divided() -> bool:
    """Return whether ranks divide the batch."""
    return _CURRENT.get() is not None


def own_count(whole: int) -> int:
    """Return how many of the first `whole` rows of a batch are this rank's.

    Where the ranks do not divide them, the batch has up to one less than their number fewer.
    """
    ranks = _CURRENT.get()
    return whole if ranks is None else whole // ranks.count


def whole_count(own: int) -> int:
    """Return how many rows the whole batch has where this rank has `own`."""
    ranks = _CURRENT.get()
    return own if ranks is None else own * ranks.count


def own_rows(values: Tensor, block: int = 1) -> Tensor:
    """Return this rank's rows of `values` of the whole batch, where `block` rows follow from each of it."""
    ranks = _CURRENT.get()
    if ranks is None:
        return values
    return values.unflatten(0, (-1, ranks.count, block))[:, ranks.number].flatten(0, 1).contiguous()


def rows_of_all_ranks(values: Tensor) -> Tensor:
    """Return the rows of the whole batch; only this rank's have gradients, `count` times those of a mean.

    A loss of all rows, which every rank computes, so has the gradient of one process once ranks' gradients
    are averaged.
    """
    ranks = _CURRENT.get()
    if ranks is None:
        return values
    rows = ranks.rows_of_all(values)
    if not values.requires_grad:
        return rows
    own = torch.arange(ranks.number, len(rows), ranks.count, device=values.device)
    # The values themselves, with gradients times `count`.
    return rows.index_copy(0, own, torch.lerp(values.detach(), values, float(ranks.count)))


def sum_of_ranks(values: Tensor) -> Tensor:
    """Return the sum of the ranks' values, without gradients; without ranks the values."""
    ranks = _CURRENT.get()
    return values.detach() if ranks is None else ranks.add(values.detach().clone())


def mean_of_ranks(values: Tensor) -> Tensor:
    """Return the mean of the ranks' values, without gradients."""
    return sum_of_ranks(values) / whole_count(1)


@contextmanager
def _telling_of_loss() -> Iterator[None]:
    """Turn what torch raises where another rank is gone into `RankLostError`."""
    try:
        yield
    except torch.OutOfMemoryError:
        raise
    except RuntimeError as error:  # torch.distributed's own, and gloo's
        raise RankLostError(f"another rank is gone or does not answer: {str(error)[:300]}") from error


def _bits(values: Tensor) -> Tensor:
    """Return a number on the CPU that depends on every bit of `values`, and on their order."""
    bits = values.detach().contiguous().reshape(-1).view(torch.uint8)
    bits = torch.nn.functional.pad(bits, (0, -len(bits) % 4)).view(torch.int32).long()
    place = torch.arange(1, len(bits) + 1, device=bits.device)
    return (bits * (2 * place + 1)).sum().cpu()
