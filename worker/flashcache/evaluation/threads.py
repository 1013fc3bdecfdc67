"""Parts of a picture on several cores: operations on a few thousand rays are too small to be divided."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import torch

Item = TypeVar("Item")
Result = TypeVar("Result")


def on_all_cores(work: Callable[[Item], Result], items: Iterable[Item], device: torch.device) -> list[Result]:
    """Return `work` of all items, in their order, without gradients.

    On a processor as many are done at once as torch may use threads, each on one core, so that results are
    the same for any number of cores; on a GPU one after another. `work` draws from generators of its own.
    """
    with torch.no_grad():
        if device.type != "cpu":
            return [work(item) for item in items]

        def alone(item: Item) -> Result:
            with torch.no_grad():
                return work(item)

        with ThreadPoolExecutor(torch.get_num_threads(), "part", torch.set_num_threads, (1,)) as pool:
            return list(pool.map(alone, items))
