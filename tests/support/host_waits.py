"""Operations for which the host of a GPU waits, and those whose results have shapes that values decide."""

import sys
from collections import Counter
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

READS = {"_local_scalar_dense", "is_nonzero", "equal"}
SHAPES = {"nonzero", "masked_select", "unique_dim", "_unique", "_unique2", "repeat_interleave.Tensor"}
COPIES = {"lift_fresh"}
"""Tensors from Python's numbers or from arrays."""
OF_PROCESSORS = "kernels/cpu.py"
"""Its compiled loops return arrays; a GPU has other kernels."""


class HostWaits(TorchDispatchMode):
    """Counts such operations, by name."""

    def __init__(self) -> None:
        super().__init__()
        self.found: Counter[str] = Counter()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Run an operation and count it."""
        name = func._schema.name.split("::")[1]
        if {name, f"{name}.{func._overloadname}"} & (READS | SHAPES | COPIES):
            self.found[name] += not _is_called_by(OF_PROCESSORS)
        if name in ("index", "index_put", "index_put_", "_index_put_impl_"):
            indices = [index for index in tree_leaves(args[1]) if index is not None]
            self.found[f"{name} by a mask"] += any(index.dtype == torch.bool for index in indices)
        return func(*args, **(kwargs or {}))


def _is_called_by(file: str) -> bool:
    """Return whether the innermost function of ours is in this file."""
    frame = sys._getframe(1)
    while frame.f_back is not None and "flashcache" not in frame.f_code.co_filename:
        frame = frame.f_back
    return frame.f_code.co_filename.endswith(file)


def host_waits(work: Any) -> dict[str, int]:
    """Return how often `work` does what a host would wait for, by the operation's name."""
    with HostWaits() as mode:
        work()
    return {name: count for name, count in mode.found.items() if count}
