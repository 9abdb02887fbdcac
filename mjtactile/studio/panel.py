"""`Panel`: tactile estimates in Studio's window, for any source of snapshots: a session, or sensors
in a user's scene.
"""

from __future__ import annotations

import time as wall
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import cv2
import numpy as np
from mujoco.studio import messages, plugin
from mujoco.studio.dear_imgui import dear_imgui as imgui
from numpy.typing import NDArray

from mjtactile.core.flags import Flags
from mjtactile.core.types import Ellipses
from mjtactile.report.overlay import find_ellipses, followed, with_ellipses
from mjtactile.studio import plots, scene_overlays, surface_colormap
from mjtactile.studio.callback_guard import guarded
from mjtactile.studio.layout import LEFT, OPTIONS, RED, WindowLayout
from mjtactile.studio.snapshot import FingerSnapshot, History, Pose, StudioSnapshot, finger_lines
from mjtactile.studio.user_scene import UserFingers

# maximum number of geoms sent to the browser (mujoco.studio.web.state_payload.MAX_EXTRA_GEOMS)
_GEOMS = 1024
_SCALE_MIN = 0.04  # minimum of the color scale
_RATE = 15.0  # maximum image rate, Hz: textures are sent to the browser
# size of transmitted images, px; rendered larger by the factor below, for smooth ellipses
_IMAGE = (320, 240)
_DETAIL = 2
_WIDTH = 170.0  # displayed width of an image, px
_NEAR = 12.0  # px of the image around an ellipse, within which the mouse is on it
_FINGER = (364, 294)  # px, a finger's window
_CURVES = 250  # px, the height of the curves


class SnapshotSource(Protocol):
    """Source of snapshots."""

    history: History

    def snapshot(self) -> StudioSnapshot | None: ...


def ellipses_of(estimated: FingerSnapshot) -> Ellipses:
    """Return the ellipses of a finger's image with the status of each.

    Tracked ellipses are used if sensing tracked all of them. Else they are detected again.
    """
    ellipses = followed(estimated.image, estimated.tracks)
    return find_ellipses(estimated.image) if ellipses is None else ellipses


class Panel(plugin.ViewerPlugin):
    """One window per finger, one with plots, and one with the overlay options.

    `fingers` are sensors in a user's scene (`mjtactile.attach(...).bind(...)`). Their list may be
    filled later. Another source of snapshots is also possible.
    """

    def __init__(self, fingers: Sequence[Any] | SnapshotSource):
        self.source: SnapshotSource = (
            UserFingers(fingers) if isinstance(fingers, Sequence) else fingers
        )
        self.options = scene_overlays.OverlayOptions()
        self._layout = WindowLayout()
        self.error = ""
        self._brush = scene_overlays.GeomPool()
        self._mine = []
        self._marked: tuple[Any, ...] = (None, None)
        self._textures: dict[tuple[int, str], int] = {}
        self._shapes: dict[tuple[int, str], float] = {}  # height over width
        self._ellipses: dict[int, Ellipses] = {}
        self._pictured: tuple[Any, ...] = ()
        self._when = 0.0
        self._updated = 0.0
        self._scale = ""

    def complain(self, text: str) -> None:
        """Show the error message of a handler."""
        self.error = text

    @messages.handler
    @guarded
    def on_update(self, _: messages.UpdateEvent) -> None:
        snapshot = self.source.snapshot()
        if snapshot is None:
            return
        fingers = self._placed(snapshot.fingers)
        now = wall.monotonic()
        # a changed selection is shown immediately
        is_due = now - self._updated > 1 / _RATE or self.options != self._marked[-1]
        if ((snapshot, self.options) != self._marked and is_due) or not self._mine:
            self._marked = (snapshot, self.options)
            self._updated = now
            before = self._mine
            scene_overlays.update(
                self._brush,
                fingers,
                self.options,
                minimum=_SCALE_MIN if self._has_membranes(snapshot) else 0.0,
            )
            self._mine = self._brush.geoms
            scene_overlays.keep(self.viewer.extra_geoms, before, self._mine, _GEOMS)
        if (snapshot, self.options.surface) != self._pictured and now - self._when > 1 / _RATE:
            self._pictured = (snapshot, self.options.surface)
            self._when = now
            self._make_figures(fingers)

    @messages.handler
    def on_model(self, _: messages.PostModelEvent) -> None:
        # the viewer has forgotten them
        self._mine = []
        self._marked = (None, None)

    @staticmethod
    def _has_membranes(snapshot: StudioSnapshot) -> bool:
        """Return True if the scene itself has membranes: then only indented parts are colored."""
        return snapshot.scene is not None or any(
            estimated.body is not None for estimated in snapshot.fingers
        )

    def _placed(self, fingers: Sequence[FingerSnapshot]) -> tuple[FingerSnapshot, ...]:
        """Return the fingers with poses in the viewer's scene, if only the MuJoCo body is known."""
        data = self.viewer.data
        placed = []
        for estimated in fingers:
            if estimated.body is not None and estimated.body < len(data.xpos):
                rotation = data.xmat[estimated.body].reshape(3, 3).copy()
                estimated = replace(
                    estimated, pose=Pose(data.xpos[estimated.body].copy(), rotation)
                )
            placed.append(estimated)
        return tuple(placed)

    def _make_figures(self, fingers: Sequence[FingerSnapshot]) -> None:
        """Render each camera's image with its ellipses, and each membrane."""
        kind = "indentation" if self.options.surface == "none" else self.options.surface
        fields = [surface_colormap.field_of(estimated, kind) for estimated in fingers]
        scale = surface_colormap.scale_of(fields)
        self._scale = surface_colormap.scale_text(kind, scale)
        for k, (estimated, field) in enumerate(zip(fingers, fields, strict=True)):
            self._ellipses[k] = ellipses_of(estimated)
            marked = with_ellipses(estimated.image, _DETAIL * _IMAGE[0], self._ellipses[k])
            height = round(marked.shape[0] / _DETAIL)
            self._upload(
                k,
                "image",
                cv2.cvtColor(
                    cv2.resize(marked, (_IMAGE[0], height), interpolation=cv2.INTER_AREA),
                    cv2.COLOR_BGR2RGB,
                ),
            )
            if field is not None:
                ratio = (field.y[-1] - field.y[0]) / (field.x[-1] - field.x[0])
                self._upload(
                    k,
                    "membrane",
                    surface_colormap.render(
                        estimated, field, scale, (_IMAGE[0], round(ratio * _IMAGE[0]))
                    ),
                )

    def _upload(self, k: int, view: str, rgb: NDArray[np.uint8]) -> None:
        height, width = rgb.shape[:2]
        self._textures[k, view] = self.viewer.upload_image(
            self._textures.get((k, view), 0), rgb.tobytes(), width, height, 3
        )
        self._shapes[k, view] = height / width

    @messages.handler
    @guarded
    def on_build_gui(self, _: messages.BuildGuiEvent) -> None:
        snapshot = self.source.snapshot()
        self._layout.start(imgui.GetIO().DisplaySize)
        self._build_overlay({} if snapshot is None else snapshot.flags)
        if snapshot is None:
            return
        for k, estimated in enumerate(snapshot.fingers):
            self._build_finger(
                estimated,
                k,
                float("nan") if snapshot.session is None else snapshot.session.perception_ms,
            )
        self._layout.place(LEFT + 14, -_CURVES, -(LEFT + _FINGER[0] + 32), _CURVES)
        if imgui.Begin("Curves")[0]:
            plots.build(
                self.source.history.curves(), [estimated.name for estimated in snapshot.fingers]
            )
        imgui.End()

    def _build_overlay(self, flags: Flags) -> None:
        """Build the window of the overlay options and the simulation's flags."""
        self._layout.place(8, -OPTIONS, LEFT, OPTIONS)
        if imgui.Begin("Touch in the scene")[0]:
            options = self.options
            choices = ["none", *surface_colormap.KINDS]
            _, chosen = imgui.Combo("membranes", choices.index(options.surface), choices)
            forces, contacts, field, camera = (
                imgui.Checkbox(text, value)[1]
                for text, value in (
                    ("net force", options.forces),
                    ("outlines, centre of pressure", options.contacts),
                    ("force distribution", options.field),
                    ("camera images", options.camera),
                )
            )
            self.options = scene_overlays.OverlayOptions(
                choices[chosen], forces, field, contacts, camera
            )
            imgui.TextUnformatted(self._scale)
            for kind, flag in flags.items():
                imgui.TextWrapped(f"warning ({kind}): {flag}")
                if flag.when:
                    imgui.TextDisabled(flag.when)
            if self.error:
                imgui.TextColored(RED, self.error)
        imgui.End()

    def _build_finger(self, estimated: FingerSnapshot, k: int, perception_ms: float) -> None:
        self._layout.place(-_FINGER[0] - 8, (_FINGER[1] + 4) * k, *_FINGER)
        if imgui.Begin(f"Finger {estimated.name}")[0]:
            self._build_image(k, "image")
            self._describe_ellipse(k, estimated)
            imgui.SameLine()
            self._build_image(k, "membrane")
            for line in finger_lines(estimated, perception_ms):
                imgui.TextUnformatted(line)
            if flagged := flagged_text(self._ellipses.get(k)):
                imgui.TextUnformatted(flagged)
            if estimated.touch.status != "ok":
                imgui.TextColored(RED, str(estimated.touch.status))
        imgui.End()

    def _build_image(self, k: int, view: str) -> None:
        if (k, view) in self._textures:
            imgui.Image(self._textures[k, view], imgui.Vec2(_WIDTH, _WIDTH * self._shapes[k, view]))

    def _describe_ellipse(self, k: int, estimated: FingerSnapshot) -> None:
        """Show a tooltip with status and size of the ellipse under the mouse."""
        ellipses = self._ellipses.get(k)
        if ellipses is None or not len(ellipses) or not imgui.IsItemHovered():
            return
        corner = imgui.GetItemRectMin()
        mouse = imgui.GetMousePos()
        scale = (estimated.image.pixels.shape[1] or 640) / _WIDTH
        at = scale * np.array([mouse.x - corner.x, mouse.y - corner.y])
        away = np.linalg.norm(ellipses.center_px - at, axis=1) - ellipses.semi_axes_px[:, 0]
        near = int(away.argmin())
        if away[near] < _NEAR:
            a, b = ellipses.semi_axes_px[near]
            imgui.SetTooltip(f"{ellipses.status[near]}\nsemi-axes {a:.1f} x {b:.1f} px")


def flagged_text(ellipses: Ellipses | None) -> str:
    """Return the number of rejected ellipses with the reasons; "" for none."""
    if ellipses is None or not len(ellipses):
        return ""
    reasons, counts = np.unique(ellipses.status[ellipses.status != "ok"], return_counts=True)
    if not len(reasons):
        return ""
    return f"{counts.sum()} of {len(ellipses)} rejected: " + ", ".join(
        f"{reason}" if count == 1 else f"{reason} ({count})"
        for reason, count in zip(reasons, counts, strict=True)
    )
