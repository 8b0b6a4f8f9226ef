"""Matches between two pictures, as LightGlue and SuperGlue give them."""

from pathlib import Path

import numpy as np

from .layout import LayoutError, files, load


def pairs(arrays, path):
    """Positions in both pictures (K, 2)."""
    missing = {"keypoints0", "keypoints1"} - arrays.keys()
    names = [key for key in ("matches", "matches0") if key in arrays]
    if missing or not names:
        raise LayoutError(f"{path}: needs keypoints0, keypoints1 and matches or matches0; it has {sorted(arrays)}")
    first, second = (np.asarray(arrays[key]).reshape(-1, 2) for key in ("keypoints0", "keypoints1"))
    matches = np.asarray(arrays[names[0]])
    # A list of pairs has two columns; one index per keypoint has none, or a leading dimension of 1.
    if matches.ndim >= 2 and matches.shape[-1] == 2 and matches.size != len(first):
        of_first, of_second = matches.reshape(-1, 2).T
    else:
        matches = matches.reshape(-1)
        of_first = np.flatnonzero(matches >= 0)
        of_second = matches[of_first]
    return first[of_first], second[of_second]


def convert(capture, folder, tracker):
    for camera in capture.cameras():
        for step, path in enumerate(files(Path(folder) / camera, {".npz", ".pt"})):
            if step + 1 < capture.frames:
                source, target = pairs(load(path), path)
                tracker.write_tracks(camera, step + 1, source, target, np.ones(len(source)))
