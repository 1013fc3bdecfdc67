"""Named figures, collected view by view."""

from dataclasses import dataclass, field

import numpy as np
from flashcache.evaluation import metrics
from lambent_proto.v1 import evaluation_pb2

UNITS = {
    "psnr": "dB",
    "psnr_gamma": "dB",
    "psnr_linear": "dB",
    "noise_ceiling": "dB",
    "mae_all": "deg",
    "mae_mask": "deg",
    "peak_angle": "deg",
}


@dataclass(slots=True)
class Table:
    """Values of named metrics, view by view."""

    values: dict[str, list[float]] = field(default_factory=dict)
    pooled: dict[str, list[float]] = field(default_factory=dict)
    """Mean squared errors per view of metrics that pool the pixels of all views before the logarithm."""
    counts: dict[str, list[int]] = field(default_factory=dict)
    """Pixels behind each entry of `pooled`."""

    def add(self, name: str, value: float) -> None:
        """Note the value of one view."""
        self.values.setdefault(name, []).append(value)

    def pool(self, name: str, error: float, count: int) -> None:
        """Note the mean squared error of one view over `count` pixels."""
        self.pooled.setdefault(name, []).append(error)
        self.counts.setdefault(name, []).append(count)

    def as_metrics(self) -> list[evaluation_pb2.Metric]:
        """Return means over the views with their standard errors, in the order they were first noted."""
        rows = []
        for name, values in self.values.items():
            rows.append(_metric(name, float(np.mean(values)), metrics.standard_error(np.array(values))))
        for name, errors in self.pooled.items():
            mean = float(np.average(errors, weights=self.counts[name]))
            error = metrics.psnr_standard_error(np.array(errors))
            rows.append(_metric(name, metrics.psnr_from_error(mean), error))
        return rows


def _metric(name: str, value: float, error: float) -> evaluation_pb2.Metric:
    unit = UNITS.get(name.rsplit("/", maxsplit=1)[-1], "1")
    return evaluation_pb2.Metric(name=name, value=value, unit=unit, standard_error=error)
