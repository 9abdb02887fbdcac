"""The two plugins: `Mirror`, on Studio's simulation thread, has the scene that the session has; `Panel`, on the viewer's, shows
what is felt and asks the session for things.

A handler that raises would end the viewer: every one is guarded, and the panel shows what it was.
"""

from __future__ import annotations

import copy
import functools
import time as wall
from collections.abc import Callable
from typing import Any

import cv2
import mujoco
import numpy as np
from mujoco.studio import messages, plugin
from mujoco.studio.dear_imgui import dear_imgui as imgui
from mujoco.studio.implot import implot

from mjtactile.core.types import Array
from mjtactile.run.overlay import with_ellipses
from mjtactile.run.report import FINGER_COLOURS
from mjtactile.run.session import Session
from mjtactile.studio.show import Show, Shown

_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_RATE = 15.0  # images a second: textures travel to the browser
_IMAGE, _SHOWN = (320, 240), (200, 150)  # px: what travels, and how large it is shown
_METRES_PER_NEWTON = 0.03
_BARS = 5  # cycles from one error bar to the next


def guarded(handler: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """A handler that shows what it raises instead of ending the viewer."""

    @functools.wraps(handler)
    def call(self: Any, event: Any) -> Any:
        try:
            return handler(self, event)
        except Exception as error:  # noqa: BLE001  # whatever it is, the session goes on
            self.show.message_(f"{type(error).__name__}: {error}")
            return None

    return call


class Mirror(plugin.SimPlugin):
    """Studio's scene is the session's: its state is taken over, and what the mouse pulls at is pulled there."""

    def __init__(self, show: Show):
        self.show = show
        self._shown: Shown | None = None
        self._model: mujoco.MjModel | None = None

    def follow(self) -> None:
        """Publish the session's model where it is a new one; Studio steps nothing without a model. For the loop around `sync`."""
        shown = self.show.latest
        if shown is not None and shown.view is not None and shown.view.model is not self._model:
            self._model = shown.view.model
            self.handle.set_model(copy.copy(self._model))

    @messages.handler(priority=messages.Priority.USER)
    @guarded
    def on_step(self, _: messages.StepEvent) -> bool:
        shown = self.show.latest
        if shown is not None and shown is not self._shown and shown.view is not None and shown.view.model is self._model:
            self._shown = shown
            model, data = self.handle.model, self.handle.data
            assert model is not None and data is not None  # it was published
            pull = data.xfrc_applied.copy()
            mujoco.mj_setState(model, data, shown.view.state, _STATE)
            data.xfrc_applied[:] = pull
            self.show.ask(functools.partial(_pull, pull))
        return True


def _pull(force: Array, session: Session) -> None:
    data = session.rig.scene.data
    if data.xfrc_applied.shape == force.shape:
        data.xfrc_applied[:] = force


class Panel(plugin.ViewerPlugin):
    """A window a finger, one with plots, one with what can be done; arrows of the felt forces in the scene."""

    def __init__(self, show: Show):
        self.show = show
        self._textures: list[int] = []
        self._drawn = -1
        self._when = 0.0
        self._supply: float | None = None

    @messages.handler
    @guarded
    def on_update(self, _: messages.UpdateEvent) -> None:
        shown = self.show.latest
        self.viewer.extra_geoms.clear()
        if shown is None:
            return
        self._draw_arrows(shown)
        if shown.number != self._drawn and wall.monotonic() - self._when > 1 / _RATE:
            self._drawn, self._when = shown.number, wall.monotonic()
            self._textures = (self._textures + [0] * len(shown.cycle.images))[:len(shown.cycle.images)]
            for k, image in enumerate(shown.cycle.images):
                rgb = cv2.cvtColor(cv2.resize(with_ellipses(image, 2 * _IMAGE[0]), _IMAGE, interpolation=cv2.INTER_AREA),
                                   cv2.COLOR_BGR2RGB)
                self._textures[k] = self.viewer.upload_image(self._textures[k], rgb.tobytes(), *_IMAGE, 3)

    def _draw_arrows(self, shown: Shown) -> None:
        """What each finger feels to push on the object, from its contact's middle."""
        if shown.view is None:
            return
        for touch, p_WS, R_WS, colour in zip(shown.cycle.touch, shown.view.p_WS, shown.view.R_WS, FINGER_COLOURS, strict=False):
            if not touch.touching or touch.traction is None or touch.contact is None:
                continue
            push = -R_WS @ touch.traction.wrench[:3]
            tip = p_WS + R_WS @ np.array([*touch.contact.centroid, 0.0])
            geom = mujoco.MjvGeom()
            rgba = np.array([*(int(colour[i:i + 2], 16) / 255 for i in (1, 3, 5)), 1.0], dtype=np.float32)
            mujoco.mjv_initGeom(geom, int(mujoco.mjtGeom.mjGEOM_ARROW), np.zeros(3), np.zeros(3), np.eye(3).ravel(), rgba)
            mujoco.mjv_connector(geom, int(mujoco.mjtGeom.mjGEOM_ARROW), 0.002, tip - _METRES_PER_NEWTON * push, tip)
            self.viewer.extra_geoms.append(geom)

    @messages.handler
    @guarded
    def on_build_gui(self, _: messages.BuildGuiEvent) -> None:
        shown = self.show.latest
        self._build_controls(shown)
        if shown is not None:
            for k in range(len(shown.cycle.touch)):
                self._build_finger(shown, k)
            self._build_plots(shown)

    def _build_controls(self, shown: Shown | None) -> None:
        show = self.show
        _place(230, 30, 270, 190)
        if imgui.Begin("Session"):
            if shown is None:
                imgui.TextUnformatted("references are being taken" if not show.outcome else show.outcome)
            else:
                cycle = shown.cycle
                imgui.TextUnformatted(f"t = {cycle.time:.2f} s   {cycle.sent.phase}   {cycle.state}")
                gripper = cycle.gripper
                imgui.TextUnformatted(f"opening {1e3 * gripper.opening:.1f} mm   lift {1e3 * gripper.lift_height:.1f} mm")
            imgui.TextUnformatted(show.outcome or show.message)
            if imgui.Button("go on###pause" if show.paused else "pause###pause"):
                show.paused = not show.paused
            imgui.SameLine()
            if imgui.Button("one cycle"):
                show.step()
            imgui.SameLine()
            if imgui.Button("again"):
                show.restart.set()
            self._build_valves()
        imgui.End()

    def _build_valves(self) -> None:
        session = self.show.session
        if session is None or not any(finger.valve is not None for finger in session.rig.fingers):
            return
        if self._supply is None:
            self._supply = 1e-3 * session.rig.fingers[0].design.chamber.supply_gauge
        _, supply = imgui.SliderFloat("supply, kPa", self._supply, 0.0, 3.0, "%.2f")
        self._supply = supply
        if imgui.Button("open valves"):
            self.show.ask(functools.partial(_open_valves, 1e3 * supply))
        imgui.SameLine()
        if imgui.Button("close valves"):
            self.show.ask(_close_valves)

    def _build_finger(self, shown: Shown, k: int) -> None:
        name = self._names(len(shown.cycle.touch))[k]
        touch = shown.cycle.touch[k]
        _place(-520, 28 + 318 * k, 240, 314)
        if imgui.Begin(f"Finger {name}"):
            if k < len(self._textures):
                imgui.Image(self._textures[k], imgui.Vec2(*_SHOWN))
            for line in finger_lines(shown, k):
                imgui.TextUnformatted(line)
            if touch.status != "ok":
                imgui.TextColored(imgui.Vec4(0.9, 0.25, 0.2, 1.0), str(touch.status))
        imgui.End()

    def _build_plots(self, shown: Shown) -> None:
        rows = list(self.show.rows)
        _place(230, -330, 500, 250)
        if imgui.Begin("Forces") and rows and implot.BeginPlot("##forces", imgui.Vec2(-1, -1)):
            time = np.array([row.time for row in rows])
            implot.SetupAxes("t, s", "normal force, N", int(implot.AxisFlags.AutoFit), int(implot.AxisFlags.AutoFit))
            for k, name in enumerate(self._names(len(shown.cycle.touch))):
                felt, sd, true = (np.array([getattr(row, part)[k] for row in rows]) for part in ("felt", "sd", "true"))
                implot.PlotLine(f"{name}, felt", time, felt)
                implot.PlotErrorBars(f"{name}, felt", time[::_BARS], felt[::_BARS], 2 * sd[::_BARS])
                if np.isfinite(true).any():
                    implot.PlotLine(f"{name}, true", time, true)
            implot.EndPlot()
        imgui.End()

    def _names(self, count: int) -> list[str]:
        session = self.show.session
        return [session.rig.fingers[k].name if session is not None else str(k) for k in range(count)]


def _place(x: int, y: int, width: int, height: int) -> None:
    """Where the next window is at first, px; negative: from the right, from below."""
    size = imgui.GetIO().DisplaySize
    at = imgui.Vec2(x if x >= 0 else max(size.x + x, 240), y if y >= 0 else max(size.y + y, 30))
    imgui.SetNextWindowPos(at, int(imgui.Cond.Once))
    imgui.SetNextWindowSize(imgui.Vec2(width, height), int(imgui.Cond.Once))


def finger_lines(shown: Shown, k: int) -> list[str]:
    """What the panel says of finger `k`."""
    touch, valves = shown.cycle.touch[k], shown.cycle.valves
    shear = float("nan") if touch.traction is None else float(np.hypot(*touch.traction.wrench[:2]))
    lines = [f"normal {touch.force_normal:+.3f} N, 2 sd {2 * touch.force_normal_sd:.3f}", f"shear  {shear:.3f} N"]
    if np.isfinite(shown.true[k]):
        lines.append(f"true   {shown.true[k]:+.3f} N")
    if touch.contact is not None:
        lines.append(f"area   {1e6 * touch.contact.area:.0f} mm2, {1e3 * touch.contact.depth:.2f} mm deep")
    lines.append(f"slip   {touch.slip.state if touch.slip is not None else 'unknown'}")
    if k < len(valves):
        gauge = valves[k].pressure_gauge
        pressure = "" if gauge is None else f", {1e-3 * gauge:.2f} kPa"
        lines.append(f"valve  {'open' if valves[k].is_open else 'closed'}{pressure}")
    return [*lines, f"image  {1e3 * touch.age:.0f} ms old; perception {shown.cycle.perception_ms:.1f} ms"]


def _open_valves(gauge: float, session: Session) -> None:
    for finger in session.rig.fingers:
        if finger.valve is not None:
            finger.valve.open(gauge)


def _close_valves(session: Session) -> None:
    for finger in session.rig.fingers:
        if finger.valve is not None:
            finger.valve.close()
