"""Compares an exported graph with the model it was exported from, whose tables may be stored as float16."""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import torch
from flashcache.encoding.hash_grid import HashGrid
from flashcache.evaluation.threads import on_all_cores
from flashcache.export.stored_grids import trained_grids
from flashcache.kernels import dispatch
from flashcache.physical.model import InverseModel
from lambent_core.errors import WorkerError
from lambent_proto.v1 import bundle_pb2
from numpy.typing import NDArray
from torch import nn

Inputs = Mapping[str, torch.Tensor]
Twin = Callable[[Any, Inputs], dict[str, torch.Tensor]]
"""The function of a graph in torch; it gets the model, or the part of one, that `compare` was given."""

TOLERANCE = 1e-5
"""Largest error allowed, absolute below 1 and relative above."""
NUDGE = 5e-7
"""A step of about the spacing of float32 numbers at a camera's distance, in scene units."""
MAX_LEFT_OUT = 0.01
"""Largest share of inputs that may be ignored because the function is too steep there for float32."""
CHUNK_ROWS = 512
MOST_ROUNDING = 1e-2
"""Root mean square of an output's error up to which float16 tables are chosen, relative above 1."""
_OWN = ("opacity", "radiance")
"""Outputs whose error is not weighted; the others are weighted by opacity, below which they mean little."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ParityResult:
    """Error of a graph relative to its torch function."""

    max_abs_error: float
    """Over all outputs of the inputs that count; relative where the value is above 1."""
    num_samples: int
    """Number of inputs that count."""
    num_left_out: int
    """Inputs where rounding alone changes the answer by more than the tolerance."""
    rounding: Sequence[bundle_pb2.Rounding] = ()
    """For each output, the error of the graph's model relative to the trained one; empty if they are one."""


def compare(
    name: str,
    graph: Path,
    twin: Twin,
    model: nn.Module,
    inputs: Inputs,
    *,
    trained: nn.Module | None = None,
    edge: tuple[str, float] | None = None,
) -> ParityResult:
    """Return the error of the graph in the file `graph` relative to `twin`, over all rows of `inputs`.

    `edge` names an output and the value of it at which other outputs jump.

    Where `model` has rounded tables, `trained` is the model without, whose answers `rounding` refers to.
    A row whose error is above 1e-5 does not count if the function is too steep there for float32 to decide:
    if the twin's own float32 result is as far from its float64 result, or if that moves as far when the input
    is nudged by 5e-7, or if it lies within 1e-5 of the `edge`. What it moves there is allowed on top of 1e-5,
    too. Raises WorkerError when another row is above, or more than 1 % of all rows are above 1e-5.
    """
    expected = _twin(twin, model, inputs)
    answers = _run(graph, inputs)
    error = _largest_error(answers, expected)
    suspects = np.flatnonzero(~(error <= TOLERANCE))
    if len(suspects) > MAX_LEFT_OUT * len(error):
        raise _refused(name, float(np.nanmax(error)), len(suspects), len(error))
    if len(suspects):
        rows = torch.from_numpy(suspects)
        few = {key: value[rows] for key, value in inputs.items()}
        few_expected = {key: value[suspects] for key, value in expected.items()}
        steep = _steepness(twin, model, few, few_expected, edge)
        wrong = suspects[~((steep > TOLERANCE) | (error[suspects] <= TOLERANCE + steep))]
        if len(wrong):
            raise _refused(name, float(error[wrong].max()), len(wrong), len(error))
    counted = np.delete(error, suspects)
    return ParityResult(
        max_abs_error=float(counted.max(initial=0.0)),
        num_samples=len(counted),
        num_left_out=len(suspects),
        rounding=rounding_of(expected, _twin(twin, trained, inputs)) if trained is not None else (),
    )


def _refused(name: str, error: float, count: int, total: int) -> WorkerError:
    return WorkerError(
        "export.parity",
        f'the graph "{name}" differs from the model by up to {error:.2e} at {count} of {total} inputs '
        f"(allowed: {TOLERANCE:.0e}); the bundle was not written. Report this with the versions of "
        f"onnxruntime ({onnxruntime.__version__}) and torch ({torch.__version__})",
    )


def _run(graph: Path, inputs: Inputs) -> dict[str, NDArray[np.float32]]:
    """Return the outputs of a graph, computed by onnxruntime in chunks."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = torch.get_num_threads()
    options.log_severity_level = 3
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    session = onnxruntime.InferenceSession(str(graph), options, providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]
    arrays = {key: value.numpy() for key, value in inputs.items()}
    parts = []
    for start in range(0, len(next(iter(arrays.values()))), CHUNK_ROWS):
        feed = {key: value[start : start + CHUNK_ROWS] for key, value in arrays.items()}
        parts.append(session.run(names, feed))
    return {name: np.concatenate([part[index] for part in parts]) for index, name in enumerate(names)}


@torch.no_grad()
def _twin(twin: Twin, model: nn.Module, inputs: Inputs) -> dict[str, NDArray[np.floating]]:
    """Return the outputs of the torch function, with full-precision matrix products.

    Torch's own operations, and not the compiled queries: their rounding is not the graph's.
    """
    precision = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("highest")
    device, dtype = next((p.device, p.dtype) for p in model.parameters())
    rows = len(next(iter(inputs.values())))

    def part(start: int) -> dict[str, torch.Tensor]:
        some = slice(start, start + CHUNK_ROWS)
        return twin(model, {key: value[some].to(device, dtype) for key, value in inputs.items()})

    try:
        with dispatch.using("encoder"):
            parts = on_all_cores(part, range(0, rows, CHUNK_ROWS), device)
    finally:
        torch.set_float32_matmul_precision(precision)
    return {name: torch.cat([part[name] for part in parts]).cpu().numpy() for name in parts[0]}


def _largest_error(
    answers: Mapping[str, NDArray[np.floating]], expected: Mapping[str, NDArray[np.floating]]
) -> NDArray[np.float64]:
    """Return the largest error of each row over all outputs; NaN where a value is not a number."""
    assert set(answers) == set(expected), f"outputs {sorted(answers)} and {sorted(expected)} differ"
    errors = [
        np.abs(answers[name].astype(np.float64) - expected[name]) / np.maximum(1.0, np.abs(expected[name]))
        for name in expected
    ]
    return np.concatenate(errors, axis=1).max(axis=1)


def _steepness(
    twin: Twin,
    model: nn.Module,
    inputs: Inputs,
    single: Mapping[str, NDArray[np.floating]],
    edge: tuple[str, float] | None,
) -> NDArray[np.float64]:
    """Return the effect of rounding on each row's result, as an error like that of `_largest_error`.

    It is infinite at the edge.
    """
    exact_model = copy.deepcopy(model).double().cpu()
    exact_inputs = {key: value.double() for key, value in inputs.items()}
    exact = _twin(twin, exact_model, exact_inputs)
    moved = [_largest_error(single, exact)]
    if edge is not None:
        name, jump = edge
        # The graph's own output may be that far on the other side.
        near = np.abs(exact[name][:, 0] - jump) <= TOLERANCE
        moved.append(np.where(near, np.inf, 0.0))
    for key, value in exact_inputs.items():
        for axis in range(value.shape[1]):
            for step in (-NUDGE, NUDGE):
                nudged = value.clone()
                nudged[:, axis] += step
                moved.append(_largest_error(_twin(twin, exact_model, {**exact_inputs, key: nudged}), exact))
    return np.max(moved, axis=0)


def with_half_tables(model: InverseModel) -> InverseModel:
    """Return a copy of `model` whose exported feature tables hold float16 numbers, as float32."""
    rounded = copy.deepcopy(model)
    with torch.no_grad():
        for grid in trained_grids(rounded):
            if isinstance(grid, HashGrid):
                grid.fold_scale()
            grid.table.copy_(grid.table.half().float())
    return rounded


def fits_half(model: InverseModel) -> bool:
    """Return whether every feature of the exported tables is inside float16's range."""
    limit = torch.finfo(torch.float16).max
    grids = trained_grids(model)
    return all(bool((grid.output_scale * grid.table.abs() <= limit).all()) for grid in grids)


def rounding_of(
    rounded: Mapping[str, NDArray[np.floating]], exact: Mapping[str, NDArray[np.floating]]
) -> list[bundle_pb2.Rounding]:
    """Return the error of each output [row, n] with rounded tables relative to exact ones, by name.

    Absolute below 1 and relative above. Errors of surface properties, normals and distances are multiplied by
    the exact answer's opacity.
    """
    weight = exact.get("opacity", np.ones((1, 1)))
    roundings = []
    for name, wanted in sorted(exact.items()):
        error = np.abs(rounded[name].astype(np.float64) - wanted) / np.maximum(1.0, np.abs(wanted))
        error = error if name in _OWN else error * weight
        rounding = bundle_pb2.Rounding(output=name, max_abs_error=error.max(), num_samples=len(error))
        rounding.rms_error = np.sqrt((error**2).mean())
        roundings.append(rounding)
    return roundings
