"""Error model of a sensor's sensing pipeline, measured by `mjtactile bench error-model`.

`--effects -mesh,-pipeline` samples the touch from it. An estimated wrench is w + G w + b(n) + e.
Here w is the ground truth (6,) and n the normal force. G is the relative mean error of each
component, and b the mean remainder at that load. The standard deviations of e depend on n. Its
correlations do not.

A part of e is independent in each image: the markers' noise. It is small and hardly depends on n.
The other part persists and decays with the time constant `slow_time`. The error that an edge causes
also affects the next image.

Objects differ more than images do. A log-normal factor therefore scales the persistent,
load-dependent part throughout a grasp. One common factor scales all shear of a grasp. The reason is
that a finger's stiffness differs from that in its file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mjtactile.core import resources
from mjtactile.core.calibration_parts import fingerprint
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.renamed import KEYS, hint
from mjtactile.core.types import Array

FOLDER = "models/fidelity/pipeline"


@dataclass(frozen=True, eq=False)
class SensingErrorModel:
    """Errors of one design's sensing pipeline.

    SI units, frame S. Values of k loads are interpolated linearly; wrenches have six components.
    """

    loads: Array  # normal forces (k,) N, increasing
    gain: Array  # mean relative error (6, 6) of the wrench with respect to the ground truth
    mean: Array  # mean (k, 6) N and N m of the remaining error
    sd: Array  # standard deviations (k, 6) of the remaining error
    fresh: Array  # standard deviations (k, 6) of its part that is independent in each image
    correlation: Array  # correlation (6, 6) of the remaining error
    reported_sd: Array  # standard deviations (k, 6) of the wrench that the pipeline reports
    reported_correlation: Array  # correlation (6, 6) that the pipeline reports
    shear_gain: float  # standard deviation of the relative error of a grasp's shear
    between: Array  # standard deviation (k,) of the logarithm of a grasp's factor
    slow_time: float  # time constant of the persistent part, s
    outliers: Array  # fraction (k,) of images with `outlier_size` times the independent error
    outlier_size: Array  # factors (6,)
    unknown: Array  # fraction (k,) of images in which the pipeline reports an unknown result
    touch_force: float  # force above which a touch starts, N
    release: float  # fraction of that force below which the touch ends
    area: Array  # mean logarithm (k,) of the ratio of estimated to true area
    area_sd: Array  # standard deviation (k,) of that logarithm
    centroid_sd: Array  # standard deviation (k,) of the centroid, m
    depth: float  # ratio of estimated to true depth
    slip_displacement: float  # sliding distance before slip is reported, m
    incipient: float  # fraction of the friction limit above which slip is incipient

    def __post_init__(self) -> None:
        for name in _ARRAYS:
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name), float))

    @cached_property
    def at_loads(self) -> Array:
        """Load-dependent errors (k, 30), in the order of `ErrorsAtLoad`."""
        return np.column_stack([getattr(self, name) for name in ErrorsAtLoad._fields])

    def at(self, load: float) -> ErrorsAtLoad:
        """Return the load-dependent errors at `load`, N, constant beyond the largest tabulated
        load."""
        columns = [np.interp(load, self.loads, column) for column in self.at_loads.T]
        return ErrorsAtLoad.of(np.array(columns))

    def table(self) -> dict[str, Any]:
        """Return the model as a table for JSON; the inverse of `parse_error_model`."""
        return {
            name: getattr(self, name).tolist() if name in _ARRAYS else getattr(self, name)
            for name in self.__dataclass_fields__
        }


class ErrorsAtLoad(NamedTuple):
    """`SensingErrorModel` at one load."""

    mean: Array
    sd: Array
    fresh: Array
    reported_sd: Array
    outliers: float
    unknown: float
    area: float
    area_sd: float
    centroid_sd: float
    between: float

    @classmethod
    def of(cls, row: Array) -> ErrorsAtLoad:
        """Create the errors from the 30 values in this order."""
        return cls(row[:6], row[6:12], row[12:18], row[18:24], *row[24:].tolist())


_ARRAYS = frozenset(
    name for name, field in SensingErrorModel.__dataclass_fields__.items() if field.type == "Array"
)


def parse_error_model(table: Mapping[str, Any]) -> SensingErrorModel:
    """Read a table of `SensingErrorModel.table`. Raises KeyError, TypeError or ValueError."""
    if old := [key for key in table if key in KEYS]:
        raise KeyError(f"unknown key{hint(old[0])}")
    values: dict[str, Any] = {
        name: np.array(table[name], float) if name in _ARRAYS else float(table[name])
        for name in SensingErrorModel.__dataclass_fields__
    }
    return SensingErrorModel(**values)


def path_of(design: SensorDesign) -> Path:
    """Return the path of the error model of a design's sensing pipeline."""
    return resources.folder(FOLDER) / f"{design.name}.json"


def load_errors(design: SensorDesign, randomized: bool = False) -> SensingErrorModel:
    """Load the errors of a design's sensing pipeline, larger if `randomized` (`--randomization`).

    Raises InputError if they were never measured, or for another design of that name.
    """
    found = _load(path_of(design), fingerprint(design), design.name)
    return found["varied" if randomized else "errors"]


@cache
def _load(path: Path, requested: str, name: str) -> dict[str, SensingErrorModel]:
    how = f"mjtactile bench error-model --sensor {name}"
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        measured_of = table["fingerprint"]
        errors = {name: parse_error_model(table[name]) for name in ("errors", "varied")}
    except FileNotFoundError:
        raise InputError(
            f"the errors of its pipeline are not measured yet: run {how}",
            source=name,
            field="--effects",
        ) from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"not a table of pipeline errors: {error!r}", source=path) from error
    if measured_of != requested:
        raise InputError(
            f"the errors of its pipeline were measured for another design of that name: run {how}",
            source=name,
            field="--effects",
        )
    return errors
