"""Captures, runs and 4D streams of fastflowgs, rendered and run stage by stage, with numpy arrays in and out.

>>> import fastflowgs
>>> run = fastflowgs.Run("out/fairmont-mini")
>>> capture = fastflowgs.Capture(run.capture)
>>> for frame in run:
...     colours, opacity = frame.render(capture.camera("trk009", frame.index))

What the program refuses raises `fastflowgs.Error`, whose message names the file. Other threads run while one of these functions works.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from . import _native
from ._native import Capture, Error, Frame, train_first_frame

__all__ = ["Capture", "Error", "Frame", "Run", "Stream", "reconstruct", "stage", "train_first_frame"]


class _Frames:
    """Frames of `source`, by their numbers in the capture and in order."""

    def __init__(self, source):
        self._source = source

    @property
    def frames(self):
        """Numbers of the frames, ascending; of a growing stream those so far."""
        return self._source.frames

    def __len__(self):
        return len(self.frames)

    def __getitem__(self, frame):
        return self._source.read(frame)

    def __iter__(self):
        return (self._source.read(frame) for frame in self.frames)


class Run(_Frames):
    """The finished frames of a run, by its output folder (`path`)."""

    def __init__(self, path):
        super().__init__(_native.Run(path))
        self.path = Path(path)

    @property
    def capture(self):
        """Folder of the capture, a Path."""
        return self._source.capture


class Stream(_Frames):
    """The frames of a 4D stream, by its folder; reading them in order costs one file each."""

    def __init__(self, path):
        super().__init__(_native.Stream(path))

    @property
    def frames_per_second(self):
        """Frames per second at which it plays."""
        return self._source.frames_per_second


def stage(name, *, literal=False, **arrays):
    """Runs one stage on arrays and returns its results by name.

    `docs/USING.md` lists the stages (voronoi, agreement, associate, triangulate, fuse, validate, rasterize, ssim) with the
    names, shapes and units of their arrays. `literal` asks for the most literal reading of the paper.
    Raises Error with the array that cannot be used, ValueError for an unknown stage.
    """
    with TemporaryDirectory() as folder:
        source, target = Path(folder) / "in.npz", Path(folder) / "out.npz"
        np.savez(source, **arrays)
        _native.stage(name, source, target, literal)
        with np.load(target) as results:
            return {key: results[key] for key in results.files}


def reconstruct(capture, out, **options):
    """Reconstructs a capture as `ffgs run` does and returns the run.

    `options` are those of `ffgs run --help` with underscores: frames="0..2", first_iterations=100, device="cpu", resume=True.
    Ctrl-C ends it after the frame at work; what was ended goes on with resume=True.
    """
    words = [str(capture), "--out", str(out)]
    for name, value in options.items():
        if value is False or value is None:
            continue
        words.append("--" + name.replace("_", "-"))
        if value is not True:
            words.append(str(value))
    _native.reconstruct(words)
    return Run(out)
