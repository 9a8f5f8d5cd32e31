"""Frames of an animation, as a GIF or an MP4."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
from PIL import Image

from fx_beam.results.files import writable


def check_frames(path: Path | str) -> Path:
    """The path of an animation; raises an error if it cannot be written."""
    path = writable(path, ("gif", "mp4"))
    if path.suffix.lower() == ".mp4" and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise RuntimeError(
            f"cannot write {path}: an MP4 needs imageio-ffmpeg: pip install imageio-ffmpeg. A GIF "
            "needs nothing more"
        )
    return path


def write_frames(frames: list[np.ndarray], path: Path, fps: int) -> None:
    """Write frames (height, width, 4) of an animation, `fps` per second."""
    if path.suffix.lower() == ".mp4":
        return _write_mp4(frames, path, fps)
    first, *others = _in_one_palette(frames)
    return first.save(path, save_all=True, append_images=others, duration=1000 // fps, loop=0)


def _write_mp4(frames: list[np.ndarray], path: Path, fps: int) -> None:
    import imageio_ffmpeg

    # H.264 needs even numbers of pixels.
    height, width = (size // 2 * 2 for size in frames[0].shape[:2])
    even = [np.ascontiguousarray(frame[:height, :width]) for frame in frames]
    film = imageio_ffmpeg.write_frames(
        str(path), (width, height), "rgba", fps=fps, quality=8, macro_block_size=2
    )
    film.send(None)
    for frame in even:
        film.send(frame)
    film.close()


def _in_one_palette(frames: list[np.ndarray]) -> list[Image.Image]:
    """Frames with one palette of 256 colours: one palette per frame would take most of the time.

    The palette is chosen from samples of all frames, in which rare colours have the same weight.
    """
    some = np.concatenate([frame[k % 3 :: 3, ::3] for k, frame in enumerate(frames)])
    palette = _image(some).quantize(256, method=Image.Quantize.MAXCOVERAGE)
    # Keep the background white: colours are matched approximately.
    colours = np.array(palette.getpalette()).reshape(-1, 3)
    colours[colours.min(axis=1) >= 245] = 255
    palette.putpalette(colours.ravel().tolist())
    plain = Image.Dither.NONE
    return [_image(frame).quantize(palette=palette, dither=plain) for frame in frames]


def _image(frame: np.ndarray) -> Image.Image:
    # Pillow drops the fourth number much faster than numpy.
    return Image.fromarray(frame).convert("RGB")
