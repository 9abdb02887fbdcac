"""Playback of a recording in Studio: touch is estimated again at full speed and shown at any
time."""

from __future__ import annotations

import bisect
import math
import threading
import time as wall
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from mujoco.studio import messages, plugin
from mujoco.studio.dear_imgui import dear_imgui as imgui

from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Image
from mjtactile.recording.reader import Recording
from mjtactile.runtime.cycle import Cycle
from mjtactile.studio.callback_guard import guarded
from mjtactile.studio.layout import ABOVE_CAMERA, LEFT, WindowLayout
from mjtactile.studio.session_bridge import ChamberReadings, SessionBridge, snapshot_of
from mjtactile.studio.snapshot import Curves, History, StudioSnapshot


class RecordingPlayer(SessionBridge):
    """Player that shows the estimates at the time `at`, s from the first cycle.

    `at` follows the clock while `playing`.
    """

    def __init__(
        self,
        scenario: Scenario,
        recording: Recording,
        notify: Callable[[str], None] = lambda _: None,
    ):
        super().__init__(scenario, notify)
        self.recording = recording
        self.history = RecordingHistory(self)
        self._snapshots: list[StudioSnapshot] = []
        self._times: list[float] = []
        self._true = recording.column("force_normal_true")
        self._lock = threading.Lock()
        self._from = 0.0
        self._since = wall.monotonic()
        self._playing = True
        self._shown: StudioSnapshot | None = None

    # called by the session's thread

    def add(self, cycle: Cycle, view: Any = None, **truth: Any) -> None:
        """Store a cycle without its images, which are in the recording."""
        cycle_index = len(self._snapshots)
        if cycle_index < len(self._true):
            true = {"force_normal_true": self._true[cycle_index].tolist()}
        else:
            true = {}
        snapshot = snapshot_of(cycle, self.session, view, true, ChamberReadings(), cycle_index)
        self.history.add(snapshot)
        if not self._times:
            self.at = 0.0
        self._snapshots.append(
            replace(
                snapshot,
                fingers=tuple(replace(estimated, image=_NOTHING) for estimated in snapshot.fingers),
            )
        )
        self._times.append(snapshot.time)
        self.latest = snapshot
        self._leave()

    # called by the viewer's thread

    @property
    def length(self) -> float:
        """Duration processed so far, s."""
        return self._times[-1] - self._times[0] if self._times else 0.0

    @property
    def at(self) -> float:
        """Time from the first cycle, s."""
        gone = wall.monotonic() - self._since if self._playing else 0.0
        return min(self._from + gone, self.length)

    @at.setter
    def at(self, time: float) -> None:
        self._from = time
        self._since = wall.monotonic()

    @property
    def playing(self) -> bool:
        return self._playing

    @playing.setter
    def playing(self, playing: bool) -> None:
        self.at = 0.0 if playing and self.at >= self.length else self.at
        self._playing = playing

    def snapshot(self) -> StudioSnapshot | None:
        """Return the snapshot at the time `at`, with its images from the disk."""
        with self._lock:
            if not self._times:
                return None
            cycle_index = max(
                bisect.bisect_right(self._times, self._times[0] + self.at + 1e-9) - 1, 0
            )
            if self._shown is None or self._shown.number != cycle_index:
                snapshot = self._snapshots[cycle_index]
                images = self.recording.images_of(cycle_index)
                fingers = (
                    replace(estimated, image=image)
                    for estimated, image in zip(snapshot.fingers, images, strict=True)
                )
                self._shown = replace(snapshot, fingers=tuple(fingers))
            return self._shown


class RecordingHistory(History):
    """History of a whole recording, with the displayed time."""

    def __init__(self, player: RecordingPlayer):
        super().__init__(seconds=math.inf)
        self._player = player

    def curves(self) -> Curves | None:
        found = super().curves()
        return None if found is None else replace(found, now=found.time[0] + self._player.at)


class PlaybackWindow(plugin.ViewerPlugin):
    """Window with the controls of the playback."""

    def __init__(self, player: RecordingPlayer):
        self.player = player
        self.complain = player.message
        self._layout = WindowLayout()

    @messages.handler
    @guarded
    def on_build_gui(self, _: messages.BuildGuiEvent) -> None:
        player = self.player
        self._layout.start(imgui.GetIO().DisplaySize)
        self._layout.place(8, 0, LEFT, ABOVE_CAMERA)
        if imgui.Begin("Recording")[0]:
            imgui.TextWrapped(str(player.recording.folder))
            snapshot = player.snapshot()
            if snapshot is not None and (state := snapshot.session) is not None:
                imgui.TextUnformatted(f"t = {snapshot.time:.2f} s   {state.phase}   {state.state}")
            if imgui.Button("stop###play" if player.playing else "play###play"):
                player.playing = not player.playing
            imgui.SameLine()
            imgui.SetNextItemWidth(-1)
            changed, at = imgui.SliderFloat(
                "##at", player.at, 0.0, max(player.length, 1e-3), "%.2f s"
            )
            if changed:
                player.playing = False
                player.at = at
            estimated = f"{len(player.history.rows)} of {len(player.recording)} cycles processed"
            imgui.TextUnformatted(
                estimated if len(player.history.rows) < len(player.recording) else ""
            )
            imgui.TextWrapped(player.outcome or player.last_message)
        imgui.End()


_NOTHING = Image([[0]])  # pyright: ignore[reportArgumentType]
