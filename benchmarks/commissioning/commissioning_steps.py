"""The day's steps: one folder with the user's files, and the emulated hardware on the table."""

from __future__ import annotations

import contextlib
import re
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.commissioning.simulated_operator import Person, photograph_board
from mjtactile.calibrate.rig_wizard import setup
from mjtactile.cli import main
from mjtactile.commands.emulate import client_text
from mjtactile.core import resources, scaled_clock
from mjtactile.core.calibration import load_calibration
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import MjtactileError
from mjtactile.core.scenario import Scenario
from mjtactile.core.toml import read_json
from mjtactile.core.types import FINGERS
from mjtactile.devices.rig import build_device_rig
from mjtactile.devices.valve.driver import connect_valves
from mjtactile.emulator.process import EmulatorProcess
from mjtactile.experiments.motion_stage import NOTHING, record_stage
from mjtactile.recording.files import write_json
from mjtactile.recording.stage_protocol import Stage, read_moves
from mjtactile.recording.writer import Recorder
from mjtactile.rig.as_built_sensor import AsBuiltSensor, true_design
from mjtactile.rig.file import load_rig_file
from mjtactile.runtime.controller import load_controller
from mjtactile.runtime.session import Session

RIG = "emulated_commissioning"
REQUIRED = 0.04  # required force error, N
SEEDS = (11, 12, 13)
HOLD = 60  # images of each grasp's hold that are compared
_PRESSES = (("press_05", 500.0), ("press_3", 3000.0))
_STILL = 40.0  # recording time of a membrane after inflation, s
_NOWHERE = {
    "servo": "/dev/none",
    "valve": "/dev/none",
    "cameras": {"left": "http://127.0.0.1:9/1", "right": "http://127.0.0.1:9/2"},
}


class Day:
    """One folder with the user's files, and the emulated hardware on the table."""

    def __init__(self, out: Path, notify: Callable[[str], None]):
        self.folder = out / "day"
        self.folder.mkdir(parents=True, exist_ok=True)
        self._out = out
        self._notify = notify
        kept = out / "commissioning.json"
        self.rows: list[dict[str, Any]] = read_json(kept)["steps"] if kept.exists() else []
        self.world = resources.find(RIG, "models/rigs", ".toml")
        self.file = self.folder / "my_gripper.toml"
        # the name links the fitted sensor to its calibration files
        self._fitted = self.folder / "fitted" / "dense.toml"
        self.sensor = str(self._fitted) if self._fitted.exists() else "dense"

    def step(self, name: str, do: Callable[[], Mapping[str, Any]]) -> None:
        """Run a step unless it is done, and store its result.

        A failed step is reported, and the day continues.
        """
        if any(row["step"] == name and "failed" not in row for row in self.rows):
            return
        start = time.monotonic()
        try:
            row: dict[str, Any] = {"step": name, **do()}
        except MjtactileError as error:
            row = {"step": name, "failed": str(error)}
        row.setdefault("seconds", _since(start))
        self.rows = [*(row for row in self.rows if row["step"] != name), row]
        write_json(self._out / "commissioning.json", self.results())
        self._notify(f"{name}: {row}")

    def results(self) -> dict[str, Any]:
        """Return the required force error, N, the clock's slow-down and the results of all
        steps."""
        return {"asked_N": REQUIRED, "slow": scaled_clock.slow(), "steps": self.rows}

    @contextlib.contextmanager
    def hardware(self, seed: int = 0) -> Iterator[EmulatorProcess]:
        """Run the emulated gripper. Its sensors are `dense` with the as-built deviations of its
        file."""
        emulator = EmulatorProcess(
            load_rig_file(self.world), load_sensor("dense"), object_name="egg", seed=seed
        )
        try:
            yield emulator
        finally:
            emulator.close()

    @contextlib.contextmanager
    def plugged_in(self, file: Path, seed: int = 0) -> Iterator[EmulatorProcess]:
        """Run the emulated gripper, and write its current ports to `file`."""
        with self.hardware(seed) as emulator:
            text = file.read_text(encoding="utf-8")
            ends = emulator.endpoints
            cameras = iter(ends["cameras"].values())
            text = re.sub(
                r'^source = ".*"', lambda _: f'source = "{next(cameras)}"', text, flags=re.M
            )
            ports = iter([ends["servo"], ends["valve"], ends["valve"]])
            text = re.sub(r'^port = ".*"', lambda _: f'port = "{next(ports)}"', text, flags=re.M)
            file.write_text(text, encoding="utf-8")
            yield emulator

    def bare(self) -> Path:
        """Write a rig file without measured values, and return its path."""
        path = self.folder / "bare.toml"
        path.write_text(client_text(self.world, _NOWHERE), encoding="utf-8")
        return path

    def set_up(self) -> dict[str, Any]:
        """Run `mjtactile setup`, then name the calibration files in the rig file.

        It finds ports, servos and cameras. When it requests an indentation of a finger, the chamber
        of that finger is filled.
        """
        like = self.bare()
        questions: list[str] = []
        pressed: list[Any] = []

        def ask(question: str) -> str:
            questions.append(question)
            if finger := re.search(r"of the (\w+) finger", question):
                while pressed:
                    pressed.pop().close(quiet=True)
                boards, valves = connect_valves(load_rig_file(self.file).valves)
                valves[FINGERS.index(finger[1])].open(1000.0)
                pressed.extend(boards)
            return ""

        with self.hardware() as emulator:
            ends = emulator.endpoints
            try:
                setup(
                    self.file,
                    like=like,
                    ports=[ends["valve"], ends["servo"]],
                    cameras=[ends["cameras"]["right"], ends["cameras"]["left"]],
                    ask=ask,
                    notify=lambda _: None,
                )
            finally:
                for board in pressed:
                    board.close(quiet=True)
            rig = load_rig_file(self.file)
            right = [camera.source for camera in rig.cameras] == [
                ends["cameras"][finger] for finger in FINGERS
            ]
        text = self.file.read_text(encoding="utf-8")
        text = text.replace("[gripper]\n", '[gripper]\ncalibration = "gripper.json"\n')
        for finger in FINGERS:
            named = f'[[camera]]\ncalibration = "{finger}.json"\nfinger = "{finger}"'
            text = text.replace(f'[[camera]]\nfinger = "{finger}"', named)
        self.file.write_text(text, encoding="utf-8")
        return {"questions": len(questions), "cameras_assigned": right}

    def _as_built_sensor(self, finger: str) -> AsBuiltSensor:
        emulator = load_rig_file(self.world).emulator
        assert emulator is not None
        return emulator.as_built_sensor(finger)

    def lens(self, finger: str) -> dict[str, Any]:
        """Run `calibrate camera` on twelve images of a printed board.

        Returns:
            True and estimated focal length and principal point along x, px.
        """
        photos = self.folder / f"photos_{finger}"
        true = true_design(load_sensor("dense"), self._as_built_sensor(finger)).camera
        photograph_board(photos, true)
        self._command("camera", str(photos), "--rig", str(self.file), "--finger", finger)
        lens = load_calibration(self.folder / f"{finger}.json").lens
        assert lens is not None
        return {"fx_px": [true.fx, lens.fx], "cx_px": [true.cx, lens.cx]}

    def _command(self, *options: str) -> None:
        code = main(["calibrate", *options])
        if code:
            raise MjtactileError(f"calibrate {options[0]}: exit code {code}")

    def calibrate(self, *options: str) -> dict[str, Any]:
        """Run one `mjtactile calibrate` command on the live rig."""
        with self.plugged_in(self.file) as emulator:
            person = Person(emulator)
            with person.at_the_terminal():
                code = main(
                    ["calibrate", *options, "--rig", str(self.file)]
                    + ([] if options[0] == "gripper" else ["--sensor", self.sensor])
                )
        reported = "".join(person.read)
        return {"exit_code": code} if code == 0 else {"exit_code": code, "failed": reported[-400:]}

    def fit(self) -> dict[str, Any]:
        """Record on a stand and run `fit --relaxation` for membrane and gas of the left finger."""
        as_built = self._as_built_sensor("left")
        nominal = load_sensor("dense")
        true = true_design(nominal, as_built)
        chamber = replace(nominal.chamber, leak_conductance=as_built.leak)
        true = replace(true, camera=nominal.camera, markers=nominal.markers, chamber=chamber)
        folders = []
        for number, (name, pressure) in enumerate((*_PRESSES, ("still", 2000.0))):
            folders.append(self.folder / name)
            if folders[-1].exists():  # left by an interrupted day
                continue
            stage = NOTHING
            if name != "still":
                stage = Stage("sphere:8", (0.0, 0.0), read_moves("press"))
            header = {"sensor": "dense", "rig": "stage", "design": "dense", "seed": number}
            part = self.folder / f"{name}.part"
            shutil.rmtree(part, ignore_errors=True)
            with Recorder(part / "recording", header) as recorder:
                record_stage(
                    replace(true, chamber=replace(chamber, supply_gauge=pressure)),
                    stage,
                    recorder,
                    seconds=_STILL if name == "still" else 9.0,
                    seed=number,
                )
            part.rename(folders[-1])
        out = self._fitted
        out.parent.mkdir(exist_ok=True)
        out.unlink(missing_ok=True)
        code = main(
            ["fit", "--relaxation", str(folders[-1]), "--out", str(out)]
            + [word for folder in folders for word in ("--recording", str(folder))]
        )
        if code:
            raise MjtactileError(f"fit: exit code {code}")
        self.sensor = str(out)
        found = load_sensor(out)
        faded = 0.0 if found.relaxation is None else found.relaxation.quick - 1
        return {
            "young_MPa": [1e-6 * true.membrane.young, 1e-6 * found.membrane.young],
            "pre_stretch": [true.membrane.pre_stretch, found.membrane.pre_stretch],
            "quick_over_lasting_less_1": [
                true.relaxation.quick - 1 if true.relaxation else 0,
                faded,
            ],
        }

    def grasps(self, sensor: str, file: Path, seeds: tuple[int, ...]) -> dict[str, Any]:
        """Grasp and hold an egg with each seed; return the force errors of each finger, N."""
        errors = []
        seconds = 0.0
        for seed in seeds:
            where = self.folder / ("before" if file.name == "bare.toml" else "after") / str(seed)
            kept = where / "felt_less_true.json"
            if not kept.exists():
                shutil.rmtree(where, ignore_errors=True)  # left by an interrupted day
                start = time.monotonic()
                found = self._grasp(sensor, file, seed, where)
                write_json(kept, {"errors_N": found.tolist(), "seconds": _since(start)})
            one = read_json(kept)
            errors.append(np.array(one["errors_N"], float))
            seconds += one["seconds"]
        mean = np.array([np.nanmean(error, axis=0) for error in errors])
        return {
            "mean_N": mean.tolist(),
            "worst_mean_N": float(np.abs(mean).max()),
            "rms_N": float(np.sqrt(np.nanmean(np.concatenate(errors) ** 2))),
            "worst_N": float(np.nanmax(np.abs(np.concatenate(errors)))),
            "seconds": round(seconds, 1),
        }

    def _grasp(self, sensor: str, file: Path, seed: int, where: Path) -> np.ndarray:
        """Record one grasp in `where`; return the force errors (images, fingers), N."""
        header = Scenario(object="egg", sensor=sensor, rig=str(file), seed=seed).header()
        with self.plugged_in(file, seed) as emulator:
            rig = build_device_rig(load_rig_file(file), load_sensor(sensor))
            try:
                return _held_error(rig, emulator, where, header)
            finally:
                rig.close()

    def shadow(self) -> dict[str, Any]:
        """Run `mjtactile compare-sim` on the first grasp after the calibrations."""
        recording = self.folder / "after" / str(SEEDS[0])
        page = self.folder / "shadow"
        code = main(
            ["compare-sim", str(recording), "--end-s", "6", "--out", str(page), "--workers", "2"]
        )
        if code not in (0, 1):
            raise MjtactileError(f"shadow: exit code {code}")
        found = read_json(page / "shadow.json")
        return {"verdict": found["verdict"], "difference_rms": found["difference_rms"]}


def _since(start: float) -> float:
    """Return the time of the emulated rig since `start`, a time of the monotonic clock, s."""
    return round((time.monotonic() - start) / scaled_clock.slow(), 1)


def _held_error(
    rig: Any, emulator: EmulatorProcess, where: Path, header: dict[str, Any]
) -> np.ndarray:
    """Return the force errors (images, fingers), N, while an egg is held."""
    errors: list[list[float]] = []
    controller = load_controller("gentle")
    with Recorder(where / "recording", header) as recorder:
        session = Session(rig, threads=0)  # no thread, whose timeout a busy computer could exceed
        recorder.start(session)
        session.take_references(recorder)

        class BriefHold:
            path = Path("gentle")

            def step(self, observation: Any) -> Any:
                command = controller.step(observation)
                return replace(command, phase="done") if len(errors) >= HOLD else command

        def on_cycle(cycle: Any) -> None:
            recorder.add(cycle)
            if cycle.sent.phase == "hold":
                truth = emulator.truth()
                errors.append(
                    [
                        touch.force_normal - truth[f"contact_{k}"]
                        for k, touch in enumerate(cycle.touch, 1)
                    ]
                )

        session.run(BriefHold(), time_limit=60.0, on_cycle=on_cycle)
    if not errors:
        raise MjtactileError("nothing was held")
    return np.array(errors)
