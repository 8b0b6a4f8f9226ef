"""Points that are followed over all frames, as DOT and CoTracker give them."""

from pathlib import Path

import numpy as np

from .layout import LayoutError, load


def positions(arrays, path):
    """Positions (T, N, 2) and visibility (T, N), 0 to 1."""
    names = [key for key in ("tracks", "pred_tracks") if key in arrays]
    if not names:
        raise LayoutError(f"{path}: no array tracks or pred_tracks; it has {', '.join(arrays) or 'none'}")
    tracks = np.asarray(arrays[names[0]], np.float32)
    tracks = tracks[0] if tracks.ndim == 4 and len(tracks) == 1 else tracks
    if tracks.ndim != 3 or tracks.shape[2] not in (2, 3):
        raise LayoutError(f"{path}: tracks of shape {tracks.shape} instead of (T, N, 2) or (T, N, 3)")
    if tracks.shape[2] == 3:
        return tracks[..., :2], tracks[..., 2]
    names = [key for key in ("visibility", "pred_visibility") if key in arrays]
    visible = np.asarray(arrays[names[0]], np.float32) if names else np.ones(tracks.shape[:2], np.float32)
    if visible.size != tracks.shape[0] * tracks.shape[1]:
        raise LayoutError(f"{path}: visibility of shape {visible.shape} beside tracks of {tracks.shape}")
    return tracks, visible.reshape(tracks.shape[:2])


def convert(capture, folder, tracker):
    for camera in capture.cameras():
        found = [path for s in (".npz", ".pt") if (path := Path(folder) / f"{camera}{s}").exists()]
        if not found:
            continue
        tracks, visible = positions(load(found[0]), found[0])
        for frame in range(1, min(capture.frames, len(tracks))):
            seen = (visible[frame - 1] > 0.5) & np.isfinite(tracks[frame - 1 : frame + 1]).all(axis=(0, 2))
            before, now = tracks[frame - 1][seen], tracks[frame][seen]
            tracker.write_tracks(camera, frame, before, now, np.clip(visible[frame][seen], 0, 1))
