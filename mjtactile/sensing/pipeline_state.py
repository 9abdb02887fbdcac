"""State passed from one image to the next: the references of a sensor, and the history since."""

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
from mjtactile.sensing.force.linearization import PlaneContact, Shape
from mjtactile.sensing.force.rest_equilibrium import InverseRest
from mjtactile.sensing.force.stress_relaxation import RelaxationState
from mjtactile.sensing.force.temporal_blending import Blend
from mjtactile.sensing.image import tracking
from mjtactile.sensing.pose.flat_reference import FlatReference
from mjtactile.sensing.touch import slip

DISPLACED_IMAGES = 3  # images in a row: a single torn image is not a displacement


@dataclass(frozen=True, eq=False)
class Reference:
    """Reference of the sensor at rest. `rest` is its statics and `surface` its surface. `first` is
    the statics as first measured, before tracking of temperature and leaks. `fiducials` are their
    detected positions (None: no fiducials). `min_force` is the minimum detectable normal force,
    N."""

    rest: InverseRest
    surface: Surface
    first: InverseRest
    fiducials: FiducialDetections | None = None
    min_force: float = 0.0


@dataclass(frozen=True, eq=False)
class PipelineState:
    """State passed from one image to the next.

    - `flat`, and `reference` once at rest: the sensor's own references.
    - `expected` (M, 3): expected marker positions, m, frame S.
    - `shape`: membrane shape; `detection`, `slip`: histories of touch and slip.
    - `tracks`: marker tracks; `offsets` (M, 3): deviation of the markers from the zero, m.
    - `gas`: gas state, with a pressure sensor.
    - `set_aside`: markers excluded because their apparent positions cannot be explained.
    - `displaced`: number of successive images in which the camera seemed displaced. With fiducials,
      it counts images in which gas seemed lost. From `DISPLACED_IMAGES` on this is accepted.
    - `face`: contact with a face wider than the frame in the last image, if any.
    - `unexplained`: number of images since the markers could not be explained.
    - `lost_at` (3,): force in the last explained image, N.
    - `fiducials`: those of the last image; `camera`: camera drift from them.
    - `camera_drift`: without fiducials, camera drift from the markers.
    - `blend`: blending of images in the camera.
    - `press`: shape history of this contact episode, if shapes are requested.
    - `flat_at`: time of the last flat membrane, s.
    - `rubber`: relaxation state, for rubber with relaxation.
    """

    flat: FlatReference
    expected: Array
    reference: Reference | None = None
    shape: Shape | None = None
    detection: contact_detection.Detection | None = None
    slip: slip.SlipHistory | None = None
    tracks: tracking.Tracks | None = None
    offsets: Array | None = None
    gas: GasState | None = None
    set_aside: tuple[int, ...] = ()
    displaced: int = 0
    face: PlaneContact | None = None
    unexplained: int = 0
    lost_at: Array | None = None
    fiducials: FiducialDetections | None = None
    camera: CameraDriftEstimate | None = None
    camera_drift: CameraDriftFilter | None = None
    blend: Blend | None = None
    press: PressHistory | None = None
    flat_at: float = -math.inf
    rubber: RelaxationState | None = None

    def required(self, sensor: str, purpose: str) -> Reference:
        """Return the rest reference. Raises DeviceError with `purpose` if it is missing."""
        if self.reference is None:
            raise DeviceError(f"sensor {sensor}: {purpose} before the rest reference")
        return self.reference

    def without_history(self) -> PipelineState:
        """Return the state with the same references, but without the images since. The states of
        gas and rubber are kept."""
        return replace(
            self,
            shape=None,
            detection=None,
            slip=None,
            tracks=None,
            offsets=None,
            set_aside=(),
            face=None,
            unexplained=0,
            lost_at=None,
            press=None,
        )
