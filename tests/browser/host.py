"""`mjtactile studio` with a reporter of its internal state.

For each line on stdin it prints one line of JSON: positions of the widgets in the last frame, px,
the written texts, the widget under the mouse, and the session's values.
"""

import json
import os
import sys
import threading
import time

from mujoco.studio import messages, plugin, ux

from mjtactile import cli
from mjtactile.studio import control_window, panel, playback, serve, session_bridge

_TEXTS = {"TextUnformatted": 0, "TextColored": 1, "TextWrapped": 0}
_WIDGETS = {"Button", "Checkbox", "Combo", "Image", "SliderFloat", "InputInt", "CollapsingHeader"}
_COMPLETE = panel.finger_lines
_PERIOD = 0.05  # minimum frame period, s
_PICTURE = "MJTACTILE_PICTURE" in os.environ  # an image is requested
MODULES = (panel, control_window, playback)
frame = {
    "places": {},
    "values": {},
    "reported": [],
    "estimates": [],
    "number": -1,
    "hovered": "",
    "active": "",
    "frames": 0,
}


class RecordingImgui:
    """Wrapper of Dear ImGui that records each widget."""

    def __init__(self, real):
        self._real = real
        self.start()

    def start(self):
        self.notes = {"places": {}, "values": {}, "reported": [], "hovered": "", "active": ""}

    def __getattr__(self, name):
        real = getattr(self._real, name)
        if name in _TEXTS:
            return lambda *args: (
                self.notes["reported"].append(str(args[_TEXTS[name]])),
                real(*args),
            )[1]
        return (lambda *args: self._note(real, args)) if name in _WIDGETS else real

    def _note(self, real, args):
        value = real(*args)
        label = str(args[0]).split("###")[0]
        low = self._real.GetItemRectMin()
        high = self._real.GetItemRectMax()
        self.notes["places"][label] = [low.x, low.y, high.x, high.y]
        self.notes["values"][label] = value[1] if isinstance(value, tuple) else None
        self.notes["hovered"] = label if self._real.IsItemHovered() else self.notes["hovered"]
        self.notes["active"] = label if self._real.IsItemActive() else self.notes["active"]
        return value


class WidgetRecorder(plugin.ViewerPlugin):
    """Plugin that records the texts and widgets of the windows in each frame."""

    def __init__(self, source, shown, app):
        self.bridge = source
        self._panel = shown
        self._app = app

    @messages.handler
    def on_init(self, event: plugin.ViewerInitEvent) -> None:
        """Turn off render effects, unless an image is requested.

        Without a graphics card they take seconds per frame.
        """
        if not _PICTURE:
            event.viewer.render_flags.flags = [0] * len(event.viewer.render_flags.flags)

    @messages.handler
    def on_update(self, _: messages.UpdateEvent) -> None:
        """Limit the frame rate: the session and the browser need the time."""
        time.sleep(_PERIOD)
        if _PICTURE:
            self._app.theme = ux.GuiTheme.DARK
        if _PICTURE and frame.pop("turn", False):  # a membrane is visible
            camera = self.viewer.camera
            camera.azimuth = camera.azimuth + 25
            camera.elevation = -25
            camera.distance = 0.75 * camera.distance
            camera.lookat = [
                *camera.lookat[:2],
                camera.lookat[2] + self.bridge.latest.session.lift_height,
            ]

    @messages.handler(priority=messages.Priority.INTERNAL)
    def on_build_gui(self, _: messages.BuildGuiEvent) -> None:
        snapshot = self.bridge.snapshot()
        now = self.bridge
        found = {
            "number": -1 if snapshot is None else snapshot.number,
            "phase": "" if snapshot is None else snapshot.session.phase,
            "estimates": []
            if snapshot is None
            else [describe(estimated) for estimated in snapshot.fingers],
            "paused": now.paused,
            "geoms": len(self.viewer.extra_geoms),
            "outcome": now.outcome,
            "runs": now.runs,
            "error": self._panel.error,
            "frames": frame["frames"] + 1,
            "places": {},
            "values": {},
            "reported": [],
            "hovered": "",
            "active": "",
        }
        for module in MODULES:
            for name, value in module.imgui.notes.items():
                found[name] = (
                    {**found[name], **value} if isinstance(value, dict) else found[name] + value
                )
            module.imgui.start()
        frame.update(found)


def describe(estimated):
    centroid = (
        estimated.touch.contact.centroid.tolist() if estimated.touch.contact is not None else None
    )
    return {
        "force": estimated.touch.force_normal,
        "sd": estimated.touch.force_normal_sd,
        "true": estimated.true,
        "centroid": centroid,
        "pressure": estimated.gauge_pressure,
    }


def answer():
    for line in sys.stdin:
        panel.finger_lines = {"break": lambda *_: 1 / 0, "mend": _COMPLETE}.get(
            line.strip(), panel.finger_lines
        )
        # start a new line: another thread may have written part of one
        sys.stdout.write("\n" + json.dumps(frame) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    for module in MODULES:
        module.imgui = RecordingImgui(module.imgui)
    launch = serve.launch

    def launch_with_recorder(config, *, plugins):
        shown = next(plugin for plugin in plugins if isinstance(plugin, panel.Panel))
        shown.source.step()  # the first cycle, and a pause: a browser may start slowly
        return launch(config, plugins=[*plugins, WidgetRecorder(shown.source, shown, plugins[0])])

    add = session_bridge.SessionBridge.add

    def add_and_pause(self, cycle, *args, **truth):
        add(self, cycle, *args, **truth)
        # once: a page may be too slow to press the button in time
        if cycle.sent.phase == "hold" and not frame.get("held"):
            frame["held"] = frame["turn"] = self.paused = True

    session_bridge.SessionBridge.add = add_and_pause
    serve.launch = launch_with_recorder
    threading.Thread(target=answer, daemon=True).start()
    sys.exit(cli.main(["studio", *sys.argv[1:]]))
