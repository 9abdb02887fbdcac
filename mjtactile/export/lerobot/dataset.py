"""Writer of LeRobot data sets: `write`."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.export.episode import RecordedEpisode, meanings, with_each
from mjtactile.export.lerobot import statistics
from mjtactile.export.lerobot.features import INDEX, SUCCESS, Feature, features_of
from mjtactile.export.lerobot.files import CHUNK, DATA_MB, FILE, VIDEO_MB, DataFiles, VideoFile
from mjtactile.recording.files import write_json


def write(
    episodes: Sequence[RecordedEpisode],
    out: Path,
    *,
    images: str = "video",
    crf: int = 0,
    task: str | None = None,
    notify: Callable[[str], None] = lambda _: None,
    leave_out: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Write all episodes into `out` and return the counts; `crf`: 0 is lossless, 18-30 lossy.

    An episode without the requested images, or incompatible with the first, is left out, and
    `leave_out` receives the reason. Raises InputError if none is left.
    """
    first, *_ = with_each(episodes, lambda one: _require_images(one, images), lambda _: None)
    fps = round(first.rate)
    features = features_of(first, images)
    episodes = with_each(
        episodes, lambda one: _checked(one, first, fps, features, images), leave_out
    )
    tasks = list(dict.fromkeys(task or episode.task for episode in episodes))
    writer = DataFiles(out, features)
    rows = []
    total = 0
    stats = []
    for k, episode in enumerate(episodes):
        notify(f"{k + 1} of {len(episodes)}: {episode.recording.folder}")
        videos = {
            key: VideoFile(out, key, k, f.shape[:2], fps, crf)
            for key, f in features.items()
            if f.dtype == "video"
        }
        text = task or episode.task
        own = features_of(episode, images)
        block, episode_rows = _episode(episode, k, total, fps, tasks.index(text), own, videos)
        row = _episode_row(episode, k, total, text, writer.add(block), videos, fps)
        for name, values in episode_rows.items():
            row |= {f"stats/{name}/{kind}": value for kind, value in values.items()}
        rows.append(row)
        total += len(episode.recording)
        stats.append(episode_rows)
        _keep_files(out, k, episode)
    writer.close()
    _write_meta(out, episodes, features, rows, tasks, stats, fps, total)
    return {"episodes": len(episodes), "frames": total, "fps": fps, "tasks": tasks}


def _checked(
    episode: RecordedEpisode,
    first: RecordedEpisode,
    fps: int,
    features: Mapping[str, Feature],
    images: str,
) -> RecordedEpisode:
    """Return the episode. Raises InputError if it is not compatible with the `first`."""
    _require_images(episode, images)
    folder = episode.recording.folder
    other = first.recording.folder
    if round(episode.rate) != fps:
        rates = f"has {episode.rate:.3g} cycles per second, but {other} has {first.rate:.3g}"
        raise InputError(rates, source=folder)
    own = {k: f.info() for k, f in features_of(episode, images).items()}
    infos = {k: f.info() for k, f in features.items()}
    if own != infos:
        odd = sorted(own.keys() ^ infos.keys()) or [k for k in own if own[k] != infos[k]]
        raise InputError(f"has different columns than {other}: {', '.join(odd[:5])}", source=folder)
    return episode


def _require_images(episode: RecordedEpisode, images: str) -> RecordedEpisode:
    """Return the episode. Raises InputError if it lacks requested images."""
    count = len(episode.recording)
    stored = sum(len(names) > 0 for names in episode.recording.columns["images"])
    if images != "none" and stored < count:
        message = f"{stored} of {count} cycles have their images; record with --frames all"
        folder = episode.recording.folder
        raise InputError(message, source=folder, field="--images", choices=["none"])
    return episode


def _episode(
    episode: RecordedEpisode,
    index: int,
    first: int,
    fps: int,
    task: int,
    features: Mapping[str, Feature],
    videos: Mapping[str, VideoFile],
) -> tuple[dict[str, list[Any]], dict[str, Any]]:
    """Return the columns of one episode, and its statistics."""
    block: dict[str, list[Any]] = {
        key: [] for key, feature in features.items() if feature.dtype != "video"
    }
    pixels: dict[str, list[Array]] = {
        key: [] for key, feature in features.items() if feature.dtype in ("video", "image")
    }
    for i, perceived in enumerate(episode.cycles()):
        for key, feature in features.items():
            value = feature.value(perceived)
            if feature.dtype in ("video", "image"):
                grey = perceived.images[list(pixels).index(key)].pixels
                if i % 10 == 0:
                    pixels[key].append(grey[::4, ::4])
                if key in videos:
                    videos[key].add(grey)
                    continue
                value = {"bytes": value.read_bytes(), "path": value.name}
            elif feature.dtype != "string":
                value = value[0].item() if len(feature.names) == 1 else value.tolist()
            block[key].append(value)
    for video in videos.values():
        video.close()
    count = len(episode.recording)
    frame_indices = np.arange(count)
    block |= {
        "timestamp": (frame_indices / fps).tolist(),
        "frame_index": frame_indices.tolist(),
        "episode_index": [index] * count,
        "index": (first + frame_indices).tolist(),
        "task_index": [task] * count,
    }
    own = {
        key: statistics.of_numbers(np.array(block[key], float).reshape(count, -1))
        for key in block
        if key in INDEX or features[key].dtype in ("float32", "float64", "bool")
    }
    for key, shots in pixels.items():
        own[key] = statistics.of_images(np.array(shots) / 255.0, features[key].shape[2])
    return block, own


def _episode_row(
    episode: RecordedEpisode,
    index: int,
    first: int,
    task: str,
    chunk_and_file: tuple[int, int],
    videos: Mapping[str, VideoFile],
    fps: int,
) -> dict[str, Any]:
    header = episode.recording.header
    length = len(episode.recording)
    row: dict[str, Any] = {
        "episode_index": index,
        "tasks": [task],
        "length": length,
        "dataset_from_index": first,
        "dataset_to_index": first + length,
        "data/chunk_index": chunk_and_file[0],
        "data/file_index": chunk_and_file[1],
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
    }
    for key, video in videos.items():
        row |= {
            f"videos/{key}/chunk_index": video.chunk_and_file[0],
            f"videos/{key}/file_index": video.chunk_and_file[1],
            f"videos/{key}/from_timestamp": 0.0,
            f"videos/{key}/to_timestamp": length / fps,
        }
    for key in ("object", "sensor", "controller", "rig"):
        row[key] = None if (value := header.get(key)) is None else str(value)
    row["seed"] = header.get("seed")
    row["outcome"] = episode.outcome or None
    row["success"] = episode.outcome == SUCCESS
    row["flags"] = ", ".join(episode.recording.flags)
    return row


def _keep_files(out: Path, index: int, episode: RecordedEpisode) -> None:
    """Write sensor, rig and calibration files, and the images of the references."""
    folder = out / "references" / f"episode-{index:06d}"
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in episode.files.items():
        (folder / name).write_text(text, encoding="utf-8")
    for name, path in episode.references.items():
        shutil.copyfile(path, folder / name)


def _write_meta(
    out: Path,
    episodes: Sequence[RecordedEpisode],
    features: Mapping[str, Feature],
    rows: Sequence[Mapping[str, Any]],
    tasks: Sequence[str],
    stats: Sequence[Mapping[str, Any]],
    fps: int,
    total: int,
) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    meta = out / "meta"
    (meta / "episodes/chunk-000").mkdir(parents=True, exist_ok=True)
    table = pa.Table.from_pylist([dict(row) for row in rows])
    pq.write_table(table, meta / "episodes/chunk-000/file-000.parquet")
    _write_tasks(meta / "tasks.parquet", tasks)
    write_json(meta / "stats.json", statistics.combine(stats))
    infos = _infos(features, fps)
    moving = any(info["dtype"] == "video" for info in infos.values())
    write_json(
        meta / "info.json",
        {
            "codebase_version": "v3.0",
            "robot_type": f"mjtactile {episodes[0].recording.header.get('rig', '')}".strip(),
            "total_episodes": len(episodes),
            "total_frames": total,
            "total_tasks": len(tasks),
            "chunks_size": CHUNK,
            "data_files_size_in_mb": DATA_MB,
            "video_files_size_in_mb": VIDEO_MB,
            "fps": fps,
            "splits": {"train": f"0:{len(episodes)}"},
            "data_path": f"data/{FILE}.parquet",
            "video_path": f"videos/{{video_key}}/{FILE}.mp4" if moving else None,
            "features": infos,
        },
    )
    facts = [episode.facts for episode in episodes]
    write_json(meta / "mjtactile.json", {"columns": meanings(), "episodes": facts})


def _write_tasks(path: Path, tasks: Sequence[str]) -> None:
    """Write the table of tasks, whose index is their text, in the format of pandas."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    indices = pa.array(range(len(tasks)), pa.int64())
    table = pa.table({"task_index": indices, "task": pa.array(tasks)})
    kinds = (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    keys = ("name", "field_name", "pandas_type", "numpy_type", "metadata")
    pandas = {
        "index_columns": ["task"],
        "column_indexes": [],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "columns": [
            dict(zip(keys, (name, name, *types, None), strict=True)) for name, *types in kinds
        ],
    }
    pq.write_table(table.replace_schema_metadata({"pandas": json.dumps(pandas)}), path)


def _infos(features: Mapping[str, Feature], fps: int) -> dict[str, Any]:
    """Return the info.json entry of each column."""
    infos = {key: feature.info() for key, feature in features.items()}
    for info in infos.values():
        if info["dtype"] == "video":
            height, width, _ = info["shape"]
            info["info"] = {
                "video.height": height,
                "video.width": width,
                "video.codec": "h264",
                "video.pix_fmt": "yuvj420p",
                "video.is_depth_map": False,
                "video.fps": fps,
                "video.channels": 1,
                "has_audio": False,
            }
    infos |= {
        name: {"dtype": "float32" if name == "timestamp" else "int64", "shape": [1], "names": None}
        for name in INDEX
    }
    return infos
