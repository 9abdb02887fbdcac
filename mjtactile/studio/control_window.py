"""`ControlWindow`: controls of a session: pause, restart, valves, manual control, puncture, and the
emergency button.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from mujoco.studio import messages, plugin
from mujoco.studio.dear_imgui import dear_imgui as imgui

from mjtactile.core import resources
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import MjtactileError
from mjtactile.experiments.fidelity_options import effects_of
from mjtactile.runtime.session import Session
from mjtactile.studio.callback_guard import guarded
from mjtactile.studio.layout import ABOVE_CAMERA, LEFT, RED, WindowLayout
from mjtactile.studio.manual_control import ManualGoal
from mjtactile.studio.session_bridge import SessionBridge
from mjtactile.studio.snapshot import StudioSnapshot

_OPEN = int(imgui.TreeNodeFlags.DefaultOpen)
_WHITE = imgui.Vec4(1.0, 1.0, 1.0, 1.0)
# conductance of a puncture, m^3/(s Pa); half of the pressure is lost within about a second
_HOLE = 1e-8
_ACCURACIES = ("", "0.005N", "0.02N", "0.05N", "realtime")
_SQUEEZE = (0.0, 3.0)  # range of the grip force slider, N
_SUPPLY = (0.0, 3.0)  # kPa
_PULL_SHOWN = 0.005  # minimum displayed pull force, N


class ControlWindow(plugin.ViewerPlugin):
    """Window with the controls of the session of `bridge`."""

    def __init__(self, bridge: SessionBridge):
        self.bridge = bridge
        self.complain = bridge.message
        self._layout = WindowLayout()
        self._supply: float | None = None
        self._pierced: set[int] = set()
        self._session: Session | None = None
        self._next = bridge.scenario

    @messages.handler
    @guarded
    def on_build_gui(self, _: messages.BuildGuiEvent) -> None:
        bridge = self.bridge
        snapshot = self.bridge.snapshot()
        if bridge.session is not self._session:  # another world
            self._session = bridge.session
            self._pierced = set()
            self._next = bridge.scenario
        self._layout.start(imgui.GetIO().DisplaySize)
        self._layout.place(8, 0, LEFT, ABOVE_CAMERA)
        if imgui.Begin("Session")[0]:
            self._build_state(snapshot)
            self._build_buttons()
            if bridge.session is not None:
                self._build_valves(bridge.session)
                if snapshot is not None and snapshot.session is not None:
                    self._build_gripper(bridge.session, snapshot)
            self._build_next()
        imgui.End()

    def _build_state(self, snapshot: StudioSnapshot | None) -> None:
        bridge = self.bridge
        if snapshot is None or snapshot.session is None:
            imgui.TextUnformatted("measuring the reference state" if not bridge.outcome else "")
        else:
            state = snapshot.session
            imgui.TextUnformatted(f"t = {snapshot.time:.2f} s   {state.phase}   {state.state}")
            imgui.TextUnformatted(
                f"opening {1e3 * state.opening:.1f} mm   lift {1e3 * state.lift_height:.1f} mm"
            )
            if state.reason and state.state not in ("armed", "running"):
                imgui.TextWrapped(state.reason)
        if (newtons := bridge.pulls) > _PULL_SHOWN:
            imgui.TextUnformatted(f"the mouse pulls with {newtons:.2f} N")
        imgui.TextWrapped(bridge.outcome or bridge.last_message)

    def _build_buttons(self) -> None:
        bridge = self.bridge
        imgui.PushStyleColor(int(imgui.Col.Button), RED)
        imgui.PushStyleColor(int(imgui.Col.Text), _WHITE)
        if imgui.Button("make it safe", imgui.Vec2(-1, 30)):
            bridge.halt()
        imgui.PopStyleColor(2)
        if bridge.may_pause:
            if imgui.Button("resume###pause" if bridge.paused else "pause###pause"):
                bridge.paused = not bridge.paused
            imgui.SameLine()
            if imgui.Button("one cycle"):
                bridge.step()
            imgui.SameLine()
        if imgui.Button("again"):
            bridge.again(replace(bridge.scenario, seed=bridge.scenario.seed + 1))

    def _build_valves(self, session: Session) -> None:
        if not session.rig.valves or not imgui.CollapsingHeader("valves", _OPEN):
            return
        if self._supply is None:
            self._supply = 1e-3 * session.rig.fingers[0].design.chamber.supply_gauge
        changed, supply = imgui.SliderFloat("supply, kPa", self._supply, *_SUPPLY, "%.2f")
        self._supply = float(supply)
        if changed:
            self._ask(_supply_open_valves, 1e3 * self._supply)
        if imgui.Button("open valves"):
            self._ask(_open_valves, 1e3 * self._supply)
        imgui.SameLine()
        if imgui.Button("close valves"):
            self._ask(_close_valves)
        if session.rig.scene is not None:
            self._build_holes(session)

    def _build_holes(self, session: Session) -> None:
        for k, finger in enumerate(session.rig.fingers):
            if k:
                imgui.SameLine()
            changed, pierced = imgui.Checkbox(f"puncture {finger.name}", k in self._pierced)
            if changed:
                self._pierced ^= {k}
                self._ask(_puncture, k, _HOLE if pierced else 0.0)

    def _build_gripper(self, session: Session, snapshot: StudioSnapshot) -> None:
        """Build the manual sliders of jaws and lift, which override the controller."""
        if not imgui.CollapsingHeader("by hand"):
            return
        bridge = self.bridge
        state = snapshot.session
        limits = session.rig.limits
        assert state is not None
        goal = bridge.manual_goal
        changed, on = imgui.Checkbox("override the controller", goal is not None)
        if changed:
            bridge.manual_goal = ManualGoal(state.opening, state.lift_height) if on else None
        if goal is None or not on:
            return
        maximum = min(limits.opening[1], 0.1), min(limits.lift[1], 0.1)
        squeezes = math.isfinite(goal.force)
        imgui.BeginDisabled(squeezes)
        _, opening = imgui.SliderFloat(
            "opening, mm", 1e3 * goal.opening, 1e3 * limits.opening[0], 1e3 * maximum[0], "%.1f"
        )
        imgui.EndDisabled()
        _, lift = imgui.SliderFloat(
            "lift, mm", 1e3 * goal.lift_height, 0.0, 1e3 * maximum[1], "%.1f"
        )
        changed, squeezes = imgui.Checkbox("regulate the force", squeezes)
        force = (0.5 if changed else goal.force) if squeezes else math.nan
        if squeezes:
            _, force = imgui.SliderFloat("force, N", force, *_SQUEEZE, "%.2f")
        if changed and not squeezes:
            opening = 1e3 * state.opening
        now = ManualGoal(1e-3 * opening, 1e-3 * lift, force)
        if now != goal:
            bridge.manual_goal = now

    def _build_next(self) -> None:
        """Build the controls for object, seed, accuracy and effects of the next world."""
        if not imgui.CollapsingHeader("another run"):
            return
        now = self._next
        if self.bridge.session is None or self.bridge.session.rig.scene is not None:
            now = replace(
                now,
                object=_choice("object", now.object, resources.names("models/objects", ".xml")),
                accuracy=_choice("accuracy", now.accuracy, _ACCURACIES, "as usual"),
            )
        _, seed = imgui.InputInt("seed", now.seed)
        self._next = replace(now, seed=max(int(seed), 0))
        if imgui.Button("start"):
            self.bridge.again(self._next)
        if now.rig == "sim" and imgui.TreeNode("effects"):
            self._build_effects()
            imgui.TreePop()

    def _build_effects(self) -> None:
        """List the effects for object and accuracy, with costs; a click overrides one."""
        now = self._next
        for name, on, text, why in _effects(now.sensor, now.object, now.accuracy, now.effects):
            changed, _ = imgui.Checkbox(f"{name}###{name}", on)
            imgui.SetItemTooltip(why)
            imgui.SameLine()
            imgui.TextDisabled(text)
            if changed:
                requested = toggled(now.effects, name, not on)
                try:
                    _effects(now.sensor, now.object, now.accuracy, requested)
                except MjtactileError as error:
                    self.complain(str(error))
                else:
                    self._next = replace(now, effects=requested)

    def _ask(self, task: Callable[..., None], *arguments: Any) -> None:
        self.bridge.ask(lambda session: task(session, *arguments))


def toggled(overrides: str, name: str, on: bool) -> str:
    """Return `overrides` ("auto" or "+a,-b") with an effect forced, or no longer."""
    parts = {
        part.strip()[1:]: part.strip()[0]
        for part in overrides.split(",")
        if overrides.strip() not in ("", "auto")
    }
    if name in parts:
        del parts[name]
    else:
        parts[name] = "+" if on else "-"
    return ",".join(sign + effect for effect, sign in parts.items()) or "auto"


@functools.lru_cache(maxsize=32)
def _effects(
    sensor: str, object_name: str, accuracy: str, overrides: str
) -> tuple[tuple[str, bool, str, str], ...]:
    """Return name, state, costs with and without, and reason of each switchable effect."""
    _, _, rows = effects_of(load_sensor(sensor), object_name, accuracy, overrides)
    return tuple(
        (str(row["effect"]), bool(row["on"]), _price(row), str(row["why"]))
        for row in rows
        if row["built"]
    )


def _price(row: dict[str, Any]) -> str:
    cost = row["cost_ms_per_s"]
    force = 1e3 * row["left_out_N"]
    if math.isnan(cost):
        return ""
    return f"{cost:.0f} ms/s" + ("" if math.isnan(force) else f", else {force:.2g} mN")


def _choice(label: str, now: str, choices: Any, empty: str = "") -> str:
    """Return the selection from `choices`; the present value is always available."""
    all_ = [*choices] if now in choices else [now, *choices]
    _, chosen = imgui.Combo(label, all_.index(now), [text or empty for text in all_])
    return all_[chosen]


def _open_valves(session: Session, gauge: float) -> None:
    for valve in session.rig.valves:
        valve.open(gauge)


def _supply_open_valves(session: Session, gauge: float) -> None:
    for valve in session.rig.valves:
        if valve.state().is_open:
            valve.open(gauge)


def _close_valves(session: Session) -> None:
    for valve in session.rig.valves:
        valve.close()


def _puncture(session: Session, finger: int, conductance: float) -> None:
    session.rig.scene.sensors[finger].puncture(conductance)
