"""What one image leaves for the next: the references of a sensor, and what was seen since."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from mjtactile.core.errors import DeviceError
from mjtactile.core.types import Array, FiducialDetections, Surface
from mjtactile.sensing.contact_shape.hypotheses import PressHistory
from mjtactile.sensing.force import contact_detection
from mjtactile.sensing.force.camera_drift_estimator import CameraDriftEstimate
from mjtactile.sensing.force.camera_drift_model import CameraDriftFilter
from mjtactile.sensing.force.gas_filter import GasState
from mjtactile.sensing.force.linearization import Shape
from mjtactile.sensing.force.rest_equilibrium import InverseRest
from mjtactile.sensing.force.stress_relaxation import RelaxationState
from mjtactile.sensing.force.temporal_blending import Blend
from mjtactile.sensing.image import tracking
from mjtactile.sensing.pose.flat_reference import FlatReference
from mjtactile.sensing.touch import slip

KNOCKS_SURE = 3  # images in a row: a torn picture is no knock


@dataclass(frozen=True, eq=False)
class Reference:
    """What the chain knows of its own sensor at rest: its statics, its `surface`, the statics as
    they were `first` measured, before they followed temperature and leaks, and where its
    `fiducials` were seen (None: it has none)."""

    rest: InverseRest
    surface: Surface
    first: InverseRest
    fiducials: FiducialDetections | None = None


@dataclass(frozen=True, eq=False)
class PipelineState:
    """What one image leaves for the next: the sensor's own references (`flat`, and `reference` once
    at rest), the marker positions `expected` (M, 3) m in S, the membrane's `shape`, the histories
    of touch and slip, the markers' `tracks`, how far they stand `apart` (M, 3) m from the
    zero, the `gas`, where a gauge measures it, the markers `set_aside` since nothing explains
    where they seem to be, and in how many images up to this one the camera seemed `knocked`, or,
    where fiducials show it, gas seemed lost: from `KNOCKS_SURE` on it was; since nothing explains
    the markers, for how many images, `unexplained`, and the force (3,) N in the last one before
    that they did explain, `lost_at`; the last image's `fiducials`, and the `camera` that they
    showed, or without any what markers have told of it, `belief`; what its pictures have told of
    how far they `blend`; what its images have told of the
    body of this `press`, where somebody asks for shapes; and of rubber that relaxes when the flat
    membrane was seen last, `flat_at` s, and what it remembers (`rubber`)."""

    flat: FlatReference
    expected: Array
    reference: Reference | None = None
    shape: Shape | None = None
    detection: contact_detection.Detection | None = None
    slip: slip.SlipHistory | None = None
    tracks: tracking.Tracks | None = None
    apart: Array | None = None
    gas: GasState | None = None
    set_aside: tuple[int, ...] = ()
    knocked: int = 0
    unexplained: int = 0
    lost_at: Array | None = None
    fiducials: FiducialDetections | None = None
    camera: CameraDriftEstimate | None = None
    belief: CameraDriftFilter | None = None
    blend: Blend | None = None
    press: PressHistory | None = None
    flat_at: float = -math.inf
    rubber: RelaxationState | None = None

    def required(self, sensor: str, what: str) -> Reference:
        """The rest reference. Raises DeviceError, of `what` came before it, where there is none."""
        if self.reference is None:
            raise DeviceError(f"sensor {sensor}: {what} before the rest reference")
        return self.reference

    def without_history(self) -> PipelineState:
        """The same references, as if no image had been seen since; what is known of the gas
        and of the rubber stays."""
        return replace(
            self,
            shape=None,
            detection=None,
            slip=None,
            tracks=None,
            apart=None,
            set_aside=(),
            unexplained=0,
            lost_at=None,
            press=None,
        )
