"""Flow files, as GMFlow writes them."""

from pathlib import Path

import numpy as np

from .layout import LayoutError, files, load


def read_flo(path):
    """A Middlebury file: (H, W, 2), px."""
    data = Path(path).read_bytes()
    if len(data) < 12 or np.frombuffer(data[:4], "<f4")[0] != np.float32(202021.25):
        raise LayoutError(f"{path}: not a Middlebury flow file")
    width, height = np.frombuffer(data[4:12], "<i4")
    if len(data) != 12 + 8 * int(width) * int(height):
        raise LayoutError(f"{path}: {len(data)} bytes do not hold {width} x {height} pixels; copy it again")
    return np.frombuffer(data[12:], "<f4").reshape(height, width, 2)


def read(path):
    if path.suffix == ".flo":
        return read_flo(path)
    arrays = load(path)
    if "flow" not in arrays:
        raise LayoutError(f"{path}: no array 'flow'; it has {', '.join(arrays) or 'none'}")
    return arrays["flow"]


def convert(capture, folder, tracker):
    for camera in capture.cameras():
        for step, path in enumerate(files(Path(folder) / camera, {".flo", ".npz"})):
            if step + 1 < capture.frames:
                tracker.write_flow(camera, step + 1, read(path))
