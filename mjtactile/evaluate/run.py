"""Execution of the missing episodes of an evaluation, in processes, and merging of its shards."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mjtactile.core import platform_support, resources
from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.core.task import load_task
from mjtactile.evaluate import emulated, report, store, worst_episodes
from mjtactile.evaluate.episodes import RANDOM, Episode, name_of, plan
from mjtactile.evaluate.pool import HERE, Notify, Pool, Running, run_all
from mjtactile.evaluate.statistics import summarise
from mjtactile.recording.files import RECORDINGS
from mjtactile.rig.domain_randomization import load_variation
from mjtactile.rig.file import load_sim_rig
from mjtactile.rig.scenario import scenario_from_table
from mjtactile.runtime.controller import load_controller

_NAMED = 5  # missing episodes


def evaluate(
    folder: Path,
    scenario: Scenario,
    *,
    count: int,
    controllers: Sequence[str],
    objects: Sequence[str],
    shard: tuple[int, int] = (1, 1),
    only: Collection[int] | None = None,
    record: bool = False,
    running: Running = HERE,
) -> dict[str, Any]:
    """Run many grasps and report the success rate.

    Args:
        folder: Output folder; it stores one line per episode.
        scenario: Scenario without controller and object; its seed is the first episode's.
        count: Episodes for each controller.
        controllers: Controllers; all run the same episodes.
        objects: Names and files, grasped in turn.
        shard: (k, n): only the k-th of n parts.
        only: Numbers of the episodes to run; None: all.
        record: True to store each episode's recording in `folder`/recordings.
        running: Execution settings of the episodes.

    Returns:
        The summary of all episodes in the folder at the end.

    Raises:
        InputError: A controller, sensor or object is not available; this is checked before any run.
            Or the folder holds another evaluation.
        DeviceError: A worker was killed. Completed episodes are stored, and the evaluation can be
            resumed.
    """
    options = {
        "count": count,
        "controllers": list(controllers),
        "objects": list(objects),
        "shard": list(shard),
        "scenario": common_settings(scenario),
    }
    if only is not None:
        options["only"] = sorted(only)
    manifest = store.manifest(options, _files(scenario, controllers, objects))
    workers = running.workers
    if workers is None:  # an emulated world, which keeps time, has all processors
        workers = 1 if emulated.check(scenario) else platform_support.processors()
    pool = Pool(running.backend, workers, running.scheduler)
    kept = store.Store(folder, manifest, resume=running.resume)
    episodes = plan(scenario, count, controllers, objects, shard=shard)
    if only is not None:
        episodes = [episode for episode in episodes if episode.index in set(only)]
    if record:
        episodes = [_recorded(episode, folder) for episode in episodes]
    done = {(line["controller"], line["episode"]) for line in kept.lines}
    missing = [one for one in episodes if (one.controller, one.index) not in done]
    if kept.lines:
        complete = len(episodes) - len(missing)
        running.notify(f"{complete} of {len(episodes)} episodes are already complete")
    run_all(missing, kept, pool, running.notify, running.run_one)
    kept.finish()
    return summarise(kept.lines)


def _recorded(episode: Episode, folder: Path) -> Episode:
    """Return the episode with a recording folder next to the results."""
    return replace(episode, recording=str((folder / RECORDINGS / episode.name).absolute()))


def write_report(
    folder: Path,
    worst_count: int | None,
    notify: Notify = lambda _: None,
    *,
    only: Collection[str] | None = None,
) -> Path:
    """Write `report.html` of an evaluation; its worst episodes are run again for their images.

    Controllers that are not in `only` are not run (None: all are). Merged results may be from
    another person, and name a program.
    """
    known = store.read_manifest(folder)
    lines = store.read_lines(folder)
    images = {}
    chosen = worst_episodes.worst(lines, worst_count)
    for k, line in enumerate(chosen, 1):
        message = f"{line['controller']}, {line['object']}, seed {line['seed']}"
        notify(f"report: running episode {k} of {len(chosen)} again for its image: {message}")
        name = name_of(line["controller"], line["episode"])
        episode = _episode(known, line, folder / store.MANIFEST)
        if only is not None and episode.scenario.controller not in only:
            notify(f"no image: the controller {episode.scenario.controller!r} is not run here")
            continue
        images[name] = worst_episodes.render(episode, folder / "worst" / name)
    path = folder / "report.html"
    with store.writing(path):
        path.write_text(report.page(known, lines, chosen, images), encoding="utf-8")
    return path


def common_settings(scenario: Scenario) -> dict[str, Any]:
    """Return the scenario settings common to all episodes; the seed is the first one's."""
    settings = scenario.to_dict().items()
    return {key: value for key, value in settings if key not in ("object", "controller")}


def _episode(manifest: Mapping[str, Any], line: Mapping[str, Any], source: Path) -> Episode:
    """Return the episode of a line."""
    options = manifest["options"]
    controllers = [name for name in options["controllers"] if Path(name).stem == line["controller"]]
    scenario = scenario_from_table(options["scenario"], source, label="options.scenario")
    return plan(scenario, line["episode"] + 1, controllers[:1], options["objects"])[-1]


def merge(folders: Sequence[Path], out: Path, *, partial: bool = False) -> dict[str, Any]:
    """Join the shards of one evaluation in `folders` into `out`.

    Returns the summary. With `partial`, its "missing" lists the episodes that no shard contains.

    Raises InputError if the shards belong to different evaluations, or if two shards differ in an
    episode. Missing episodes without `partial` also raise it.
    """
    parts = [store.read_manifest(folder) for folder in folders]
    for folder, part in zip(folders[1:], parts[1:], strict=True):
        for name in ("versions", "files", "options"):
            first, other = (each[name] | {"shard": None} for each in (parts[0], part))
            if differing := store.differences(first, other):
                message = f"its {name} differ from those of {folders[0]}: {differing}"
                raise InputError(message, source=folder, field="--merge")
    lines = _joined(folders)
    options = parts[0]["options"] | {"shard": [1, 1]}
    missing = _missing(options, lines)
    if missing and not partial:
        message = f"{missing_text(missing)}; --partial joins the available ones"
        raise InputError(message, field="--merge")
    merged = parts[0] | {"options": options, "command": store.command(options)}
    joined = store.Store(out, merged, resume=False)
    joined.lines = [lines[key] for key in sorted(lines)]
    joined.finish()
    return summarise(joined.lines) | ({"missing": missing} if missing else {})


def _joined(folders: Sequence[Path]) -> dict[tuple[int, str], dict[str, Any]]:
    """Join all lines by episode and controller. Raises InputError if two folders differ in one."""
    lines: dict[tuple[int, str], dict[str, Any]] = {}
    homes: dict[tuple[int, str], Path] = {}
    for folder in folders:
        for line in store.read_lines(folder):
            key = line["episode"], line["controller"]
            if lines.setdefault(key, line) != line:
                message = f"episode {key[0]} of {key[1]} differs from the one in {homes[key]}"
                raise InputError(message, source=folder, field="--merge")
            homes.setdefault(key, folder)
    return lines


def _missing(options: Mapping[str, Any], lines: Collection[tuple[int, str]]) -> list[str]:
    """Return the names of the episodes of the evaluation without a line."""
    controllers = [Path(name).stem for name in options["controllers"]]
    return [
        name_of(controller, index)
        for index in range(options["count"])
        for controller in controllers
        if (index, controller) not in lines
    ]


def missing_text(missing: Sequence[str]) -> str:
    """Return the number of missing episodes and the first few names."""
    shown = ", ".join(missing[:_NAMED]) + (", …" if len(missing) > _NAMED else "")
    are = "episode is" if len(missing) == 1 else "episodes are"
    return f"{len(missing)} {are} missing: {shown}"


def _files(scenario: Scenario, controllers: Sequence[str], objects: Sequence[str]) -> list[Path]:
    """Return the files in use, each once. Raises InputError if one is not available or valid."""
    from mjtactile.sim.effects.catalog import choose
    from mjtactile.sim.scenes.objects import load_object
    from mjtactile.sim.scenes.random_objects import seed_of

    for name in controllers:
        load_controller(name)
    named = [name for name in objects if name != RANDOM]
    for name in named:
        load_object(name)
    stems = [Path(name).stem for name in controllers]
    twice = next((stem for stem in stems if stems.count(stem) > 1), None)
    if twice is not None:
        raise InputError(f"two controllers have the name {twice!r}", field="--controller")
    if emulated.check(scenario):
        rig_files = emulated.files(scenario)
    else:
        rig = load_sim_rig(scenario.rig)
        rig_files = [rig.path, rig.model]
    choose(scenario.design(), overrides=scenario.effects)
    variation = load_variation(scenario.randomization)
    load_task(scenario.task)
    find = resources.find
    objects = [name for name in named if seed_of(name) is None]
    found = [find(name, "controllers", ".py") for name in controllers]
    found += [find(name, "models/objects", ".xml") for name in objects]
    sensors = [scenario.sensor_name, *scenario.sensors.values()]
    found += [find(name, "models/sensors", ".toml") for name in sensors]
    found += [*rig_files, find(scenario.task, "models/tasks", ".toml")]
    if variation.path is not None:
        found.append(variation.path)
    return list(dict.fromkeys(found))
