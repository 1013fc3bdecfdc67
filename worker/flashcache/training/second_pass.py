"""Pass B in parallel with pass A, on a second core if there is one, with bit-identical results.

Pass B works on a twin of the model that shares its values and has gradients of its own: both passes can then
be computed and differentiated at the same time, and their gradients are added in one fixed order.
"""

import copy
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager

import torch
from jaxtyping import Float
from torch import Tensor, nn

from flashcache.caches.nerf_cache import Geometry
from flashcache.config import StageTwoConfig
from flashcache.data.ray_batches import RayBatch
from flashcache.physical.model import InverseModel
from flashcache.training.passes import Pass, shade


def twin_of(model: InverseModel) -> InverseModel:
    """Return a model that shares all values with `model`, and has parameters and gradients of its own."""
    twin = copy.deepcopy(model)
    for own, other in zip(model.parameters(), twin.parameters(), strict=True):
        other.data = own.data
    for name, buffer in model.named_buffers():
        module, _, leaf = name.rpartition(".")
        setattr(twin.get_submodule(module), leaf, buffer)
    return twin


def half_of(num_threads: int) -> int:
    """Return how many threads each of two workers may use."""
    return max(1, num_threads // 2)


@contextmanager
def half_the_threads(active: bool) -> Iterator[None]:
    """Let operations of this thread use half the cores while `active`; another thread uses the others."""
    before = torch.get_num_threads()
    if active:
        torch.set_num_threads(half_of(before))
    try:
        yield
    finally:
        if active:
            torch.set_num_threads(before)


class SecondPass:
    """Pass B of every step: `start` it and take its `result`.

    With `symmetric` it also carries gradients: `differentiate` it, then `collect` them. Otherwise it is a
    constant of the other pass.
    """

    def __init__(self, model: InverseModel, config: StageTwoConfig) -> None:
        self.model, self.config = model, config
        device = next(model.parameters()).device
        threads = torch.get_num_threads()
        self.parallel = device.type == "cpu" and threads > 1
        self._pool = None
        if self.parallel:
            self._pool = ThreadPoolExecutor(1, "pass-b", torch.set_num_threads, (half_of(threads),))
        self._twin = twin_of(model) if config.symmetric else model
        self._pairs: list[tuple[nn.Parameter, nn.Parameter]] = []
        if config.symmetric:
            self._pairs = list(zip(self._reached(model), self._reached(self._twin), strict=True))
            for _, other in self._pairs:
                other.grad = torch.zeros_like(other)
        self._normal: Tensor | None = None
        self._job: Future | None = None

    def start(self, batch: RayBatch, geometry: Geometry, generator: torch.Generator) -> None:
        """Start the pass; the gradient that reaches the normals of `geometry` is collected."""
        normal = geometry.normal.detach()
        self._normal = normal.requires_grad_(geometry.normal.requires_grad and self.config.symmetric)
        own = geometry._replace(
            hidden=geometry.hidden.detach(), weights=geometry.weights.detach(), normal=self._normal
        )

        def run() -> Pass:
            with torch.set_grad_enabled(self.config.symmetric):
                return shade(self._twin, self.config, batch, own, generator, supervise=False)

        self._job = self._submit(run)

    def result(self) -> Pass:
        """Wait for the pass and return it."""
        assert self._job is not None, "start comes first"
        return self._job.result()

    def differentiate(self, picture: Float[Tensor, "rays 3"], gradient: Float[Tensor, "rays 3"]) -> None:
        """Begin to carry the gradient of the loss by the pass's picture back to the twin."""
        self._job = self._submit(lambda: picture.backward(gradient))

    def collect(self, geometry: Geometry) -> None:
        """Add the twin's gradients to the model's, and carry those of `geometry` back through it."""
        assert self._job is not None, "differentiate comes first"
        self._job.result()
        with torch.no_grad():
            for own, other in self._pairs:
                if own.grad is not None and other.grad is not None:
                    own.grad += other.grad
                    other.grad.zero_()
        if self._normal is not None and self._normal.grad is not None:
            geometry.normal.backward(self._normal.grad)

    def _submit(self, work: Callable) -> Future:
        if self._pool is not None:
            return self._pool.submit(work)
        done: Future = Future()
        done.set_result(work())
        return done

    def _reached(self, model: InverseModel) -> list[nn.Parameter]:
        """Return the parameters that the picture's gradient can reach, but for those behind the geometry."""
        parts: list[nn.Module] = [model.materials, model.environment]
        if self.config.estimator.through_cache:
            parts += [model.nerf.density, model.nerf.normals, model.nerf.appearance, model.fast]
        return [parameter for part in parts for parameter in part.parameters() if parameter.requires_grad]
