"""What the sensing chain of a sensor errs by, as `mjtactile bench drawn` has measured it: what
`--effects -sheet,-chain` draws touch with.

A felt wrench is w + G w + b(n) + e, with w the true one (6,), n the force that presses, G the mean
error as a share of each part, b the mean of what is left at that load. Of e, whose standard
deviations go with n and whose correlations do not, a part is new in each image: the markers' noise,
which is small and hardly goes with n. The rest lasts, and fades with the time constant `slow_time`:
what an edge does to a chain, it does to the next image, too. Things differ more than images do:
what lasts and comes with a load is larger or smaller throughout a grasp, by a factor whose
logarithm is normal; and all shear of a grasp is felt too large or too small by one share, since a
finger's stiffness is not its file's.
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
from mjtactile.core.types import Array

FOLDER = "models/fidelity/chain"


@dataclass(frozen=True, eq=False)
class SensingErrorModel:
    """Errors of one design's chain. SI units, frame S; k loads, six parts of a wrench.

    Attributes:
        loads: (k,) N that press, increasing; between them all below is linear.
        gain: (6, 6) mean error of the wrench by the true one.
        mean: (k, 6) N and N m, mean of what is left.
        sd: (k, 6) standard deviations of what is left then.
        fresh: (k, 6) of what of that is new in each image.
        correlation: (6, 6) of that.
        said: (k, 6) standard deviations that the chain says of its wrench.
        reported_correlation: (6, 6).
        shear_gain: Standard deviation of the share by which a grasp's shear is felt too large.
        between: (k,) standard deviation of the logarithm of a grasp's factor.
        slow_time: s, time constant of what lasts.
        outliers: (k,) share of images in which what is new is `outlier_size` times as large.
        outlier_size: (6,) see there.
        unknown: (k,) share of images in which the chain says that it does not know.
        touch_force: N, above which there is a touch.
        release: Share of that, below which it ends.
        area: (k,) mean logarithm of the felt area over the true one.
        area_sd: (k,) its standard deviation.
        centroid_sd: (k,) m.
        depth: Share of the true depth that is felt.
        slip_displacement: m that is slid before it is called so.
        incipient: Share of friction's limit from which on a slip is near.
    """

    loads: Array
    gain: Array
    mean: Array
    sd: Array
    fresh: Array
    correlation: Array
    said: Array
    reported_correlation: Array
    shear_gain: float
    between: Array
    slow_time: float
    outliers: Array
    outlier_size: Array
    unknown: Array
    touch_force: float
    release: float
    area: Array
    area_sd: Array
    centroid_sd: Array
    depth: float
    slip_displacement: float
    incipient: float

    def __post_init__(self) -> None:
        for name in _ARRAYS:
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name), float))

    @cached_property
    def at_loads(self) -> Array:
        """(k, 30) All that goes with the load, in the order of `ErrorsAtLoad`."""
        return np.column_stack([getattr(self, name) for name in ErrorsAtLoad._fields])

    def at(self, load: float) -> ErrorsAtLoad:
        """All that goes with the load, at `load` N; beyond the last one as there."""
        columns = [np.interp(load, self.loads, column) for column in self.at_loads.T]
        return ErrorsAtLoad.of(np.array(columns))

    def table(self) -> dict[str, Any]:
        """As JSON has it; the inverse of `parse_error_model`."""
        return {
            name: getattr(self, name).tolist() if name in _ARRAYS else getattr(self, name)
            for name in self.__dataclass_fields__
        }


class ErrorsAtLoad(NamedTuple):
    """`SensingErrorModel` at one load."""

    mean: Array
    sd: Array
    fresh: Array
    said: Array
    outliers: float
    unknown: float
    area: float
    area_sd: float
    centroid_sd: float
    between: float

    @classmethod
    def of(cls, row: Array) -> ErrorsAtLoad:
        """Of the 30 numbers in this order."""
        return cls(row[:6], row[6:12], row[12:18], row[18:24], *row[24:].tolist())


_ARRAYS = frozenset(
    name for name, field in SensingErrorModel.__dataclass_fields__.items() if field.type == "Array"
)


def parse_error_model(table: Mapping[str, Any]) -> SensingErrorModel:
    """Read what `SensingErrorModel.table` wrote. Raises KeyError, TypeError or ValueError."""
    values: dict[str, Any] = {
        name: np.array(table[name], float) if name in _ARRAYS else float(table[name])
        for name in SensingErrorModel.__dataclass_fields__
    }
    return SensingErrorModel(**values)


def path_of(design: SensorDesign) -> Path:
    """Where the errors of a design's chain are kept."""
    return resources.folder(FOLDER) / f"{design.name}.json"


def load_errors(design: SensorDesign, varied: bool = False) -> SensingErrorModel:
    """The errors of a design's chain.

    Args:
        design: As its file says, without anything left out.
        varied: Whether the sensor is not as its file says (`--vary`): then they are larger.

    Returns:
        The errors.

    Raises:
        InputError: They were never measured, or of another design of that name.
    """
    found = _load(path_of(design), fingerprint(design), design.name)
    return found["varied" if varied else "errors"]


@cache
def _load(path: Path, wanted: str, name: str) -> dict[str, SensingErrorModel]:
    how = f"mjtactile bench drawn --sensor {name}"
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        measured_of = table["fingerprint"]
        errors = {name: parse_error_model(table[name]) for name in ("errors", "varied")}
    except FileNotFoundError:
        raise InputError(
            f"the errors of its chain were never measured: {how}", source=name, field="--effects"
        ) from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"no errors of a chain: {error!r}", source=path) from error
    if measured_of != wanted:
        raise InputError(
            f"the errors of its chain were measured of another design of that name: {how}",
            source=name,
            field="--effects",
        )
    return errors
