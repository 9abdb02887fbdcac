"""Writer of video frames to a file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.errors import MjtactileError

Pixels = NDArray[np.uint8]
NOTE = "written by mjtactile, whose next film of that name may replace it"


class Writer:
    """`with Writer(path, suffix, rate) as write: write(bgr)`: images through PyAV."""

    _CODECS: Mapping[str, tuple[str, str, str, dict[str, str]]] = {
        ".mp4": ("libx264", "mp4", "yuv420p", {"crf": "20", "preset": "veryfast"}),
        ".gif": ("gif", "gif", "pal8", {}),
        ".webp": ("libwebp_anim", "webp", "yuv420p", {"quality": "70", "loop": "0"}),
    }

    def __init__(self, path: Path, suffix: str, rate: float):
        try:
            import av
        except ImportError as error:
            raise MjtactileError("PyAV is not installed: pip install 'mjtactile[video]'") from error
        self._av: Any = av
        self._path = path
        self._suffix = suffix
        self._rate = round(rate)
        self._frames: list[Any] = []
        self._stream: Any = None

    def __enter__(self) -> Callable[[Pixels], None]:
        self._file = self._av.open(str(self._path), "w", format=self._CODECS[self._suffix][1])
        self._file.metadata["comment"] = NOTE
        return self._write

    def _write(self, bgr: Pixels) -> None:
        frame = self._av.VideoFrame.from_ndarray(bgr, format="bgr24")
        if self._stream is None:
            codec, _, pixels, options = self._CODECS[self._suffix]
            self._stream = self._file.add_stream(codec, rate=self._rate, options=options)
            self._stream.width = frame.width
            self._stream.height = frame.height
            self._stream.pix_fmt = pixels
        if self._suffix == ".gif":
            self._frames.append(frame)
        else:
            self._file.mux(self._stream.encode(frame))

    def __exit__(self, kind: object, *rest: object) -> None:
        if kind is None:
            for frame in self._paletted():
                self._file.mux(self._stream.encode(frame))
            self._file.mux(self._stream.encode())
        self._file.close()
        if kind is not None:
            self._path.unlink(missing_ok=True)

    def _paletted(self) -> Iterator[Any]:
        """Yield the frames with one common palette of 64 colors."""
        if not self._frames:
            return
        graph = self._av.filter.Graph()
        first = self._frames[0]
        source = graph.add_buffer(
            width=first.width, height=first.height, format=first.format, time_base=f"1/{self._rate}"
        )
        split = graph.add("split")
        choose = graph.add("palettegen", "max_colors=64")
        use = graph.add("paletteuse", "dither=none")
        sink = graph.add("buffersink")
        source.link_to(split)
        split.link_to(use, 0, 0)
        split.link_to(choose, 1, 0)
        choose.link_to(use, 0, 1)
        use.link_to(sink)
        graph.configure()
        for k, frame in enumerate(self._frames):
            frame.pts = k
            source.push(frame)
        source.push(None)
        for _ in self._frames:
            yield sink.pull()


def write_frames(
    image: Pixels,
    text: str,
    at: tuple[int, int],
    size: float,
    colour: tuple[int, ...],
    width: int = 1,
) -> None:
    cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, colour, width, cv2.LINE_AA)
