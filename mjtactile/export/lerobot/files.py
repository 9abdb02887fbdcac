"""The large files of a LeRobot data set: frames as parquet, images as video."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.types import Array
from mjtactile.export.lerobot.features import INDEX, Feature

CHUNK = 1000
DATA_MB = 100
VIDEO_MB = 200
FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"


class DataFiles:
    """The parquet files of frames: one row group per episode, and a new file after a full one."""

    def __init__(self, out: Path, features: Mapping[str, Feature]):
        import pyarrow as pa

        kinds = {
            "float32": pa.float32(),
            "float64": pa.float64(),
            "bool": pa.bool_(),
            "string": pa.string(),
            "image": pa.struct([("bytes", pa.binary()), ("path", pa.string())]),
        }

        def kind(feature: Feature) -> Any:
            dtype = kinds[feature.dtype]
            if len(feature.names) == 1 or feature.dtype == "image":
                return dtype
            return pa.list_(dtype, len(feature.names))

        fields = [
            (key, kind(feature)) for key, feature in features.items() if feature.dtype != "video"
        ]
        fields += [(name, pa.float32() if name == "timestamp" else pa.int64()) for name in INDEX]
        self._schema = pa.schema(fields)
        self._out = out
        self._file = -1
        self._size = 0.0
        self._writer: Any = None

    def add(self, block: Mapping[str, Any]) -> tuple[int, int]:
        """Append an episode, and return its chunk and file."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        table = pa.table(dict(block), schema=self._schema)
        if self._writer is None or self._size > DATA_MB * 1e6:
            self.close()
            self._file = self._file + 1
            self._size = 0.0
            path = (
                self._out
                / "data"
                / FILE.format(chunk_index=self._file // CHUNK, file_index=self._file % CHUNK)
            )
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(path.with_suffix(".parquet"), self._schema)
        self._writer.write_table(table)
        self._size += table.nbytes
        return divmod(self._file, CHUNK)

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()


class VideoFile:
    """One episode of one camera as H.264, grey."""

    def __init__(self, out: Path, key: str, index: int, size: tuple[int, ...], fps: int, crf: int):
        import av

        self.chunk_and_file = divmod(index, CHUNK)
        path = (
            out
            / "videos"
            / key
            / (
                FILE.format(chunk_index=self.chunk_and_file[0], file_index=self.chunk_and_file[1])
                + ".mp4"
            )
        )
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = av.open(str(path), "w")
        stream = self._file.add_stream("libx264", rate=fps)
        stream.height, stream.width, stream.pix_fmt = *size, "gray"
        stream.codec_context.color_range = 2  # 0-255, not 16-235
        stream.codec_context.time_base = Fraction(1, fps)
        stream.options = {
            "preset": "veryfast",
            "g": "2",
            "bf": "0",
            "x264-params": "log-level=none",
            **({"qp": "0"} if crf == 0 else {"crf": str(crf)}),
        }
        self._stream = stream
        self._count = 0
        self._fps = fps

    def add(self, grey: Array) -> None:
        import av

        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(grey), format="gray")
        frame.pts = self._count
        frame.time_base = Fraction(1, self._fps)
        frame.color_range = 2
        self._count += 1
        self._file.mux(self._stream.encode(frame))

    def close(self) -> None:
        self._file.mux(self._stream.encode())
        self._file.close()
