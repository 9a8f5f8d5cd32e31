"""Frames of an animation, as a GIF or an MP4."""

from __future__ import annotations

import importlib.util
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from fx_beam.results.files import writable

_SAMPLES = 40_000  # pixels of a frame from which the palette is chosen


def check_frames(path: Path | str) -> Path:
    """The path of an animation; raises an error if it cannot be written."""
    path = writable(path, ("gif", "mp4"))
    if path.suffix.lower() == ".mp4" and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise RuntimeError(
            f"cannot write {path}: an MP4 needs imageio-ffmpeg: pip install imageio-ffmpeg. A GIF "
            "needs nothing more"
        )
    return path


def write_frames(frames: Iterator[np.ndarray], path: Path, fps: int) -> None:
    """Write frames (height, width, 4) of an animation, `fps` per second, one after the other."""
    (_write_mp4 if path.suffix.lower() == ".mp4" else _write_gif)(frames, path, fps)


def _write_mp4(frames: Iterator[np.ndarray], path: Path, fps: int) -> None:
    import imageio_ffmpeg

    film = None
    for frame in frames:
        # H.264 needs even numbers of pixels.
        height, width = (size // 2 * 2 for size in frame.shape[:2])
        if film is None:
            look = {"fps": fps, "quality": 8, "macro_block_size": 2}
            film = imageio_ffmpeg.write_frames(str(path), (width, height), "rgba", **look)
            film.send(None)
        film.send(np.ascontiguousarray(frame[:height, :width]))
    if film is not None:
        film.close()


def _write_gif(frames: Iterator[np.ndarray], path: Path, fps: int) -> None:
    """Frames with one palette of 256 colours: one palette per frame would take most of the time.

    The palette is chosen from samples of all frames; until then they are compressed, as 200 frames
    in full HD would take 1.6 GB.
    """
    packed, samples, size = [], [], (0, 0)
    for k, frame in enumerate(frames):
        size = frame.shape[1], frame.shape[0]
        apart = max(3, round((size[0] * size[1] / _SAMPLES) ** 0.5))
        samples.append(frame[k % apart :: apart, ::apart].reshape(1, -1, 4))
        packed.append(zlib.compress(frame.tobytes(), 1))
    palette = _palette(np.concatenate(samples, axis=1))
    plain = Image.Dither.NONE
    first, *others = (
        Image.frombytes("RGBA", size, zlib.decompress(one))
        .convert("RGB")
        .quantize(palette=palette, dither=plain)
        for one in packed
    )
    first.save(path, save_all=True, append_images=others, duration=1000 // fps, loop=0)


def _palette(pixels: np.ndarray) -> Image.Image:
    """A palette of 256 colours, in which rare ones have the same weight, and white."""
    palette = (
        Image.fromarray(pixels).convert("RGB").quantize(256, method=Image.Quantize.MAXCOVERAGE)
    )
    # Keep the background white: colours are matched approximately.
    colours = np.array(palette.getpalette()).reshape(-1, 3)
    colours[colours.min(axis=1) >= 245] = 255
    palette.putpalette(colours.ravel().tolist())
    return palette
