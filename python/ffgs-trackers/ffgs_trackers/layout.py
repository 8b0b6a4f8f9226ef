"""The layout of a capture: its cameras and images, and the tracks that are written into it."""

import json
import os
from pathlib import Path

import numpy as np


class LayoutError(Exception):
    """Names the file and what to do about it."""


class Capture:
    """The training cameras of a capture and their images over the frames."""

    def __init__(self, root):
        self.root = Path(root)
        file = self.root / "train_meta.json"
        try:
            names = json.loads(file.read_text())["fn"]
        except (OSError, ValueError, KeyError) as error:
            raise LayoutError(f"{file}: no list of images ({error}); give the folder of a capture") from error
        self.frames = len(names)
        self.images = {}
        for frame, of_frame in enumerate(names):
            for name in of_frame:
                self.images.setdefault(name.split("/")[0], {})[frame] = self.root / "ims" / name

    def cameras(self):
        return sorted(self.images)

    def image(self, camera, frame):
        """(H, W, 3), 0 to 255; `None` where the camera has no image of that frame."""
        from PIL import Image

        path = self.images[camera].get(frame)
        return None if path is None else np.asarray(Image.open(path).convert("RGB"))


class Tracker:
    """Files of one tracker below `tracks/`, and its entry in `tracks.json`."""

    def __init__(self, capture, name, level, pixel_center="integer"):
        if not name or any(c in name for c in "/\\{}") or name.startswith("."):
            raise LayoutError(f"'{name}' cannot be the name of a folder; choose another with --name")
        self.capture, self.name, self.level, self.pixel_center = capture, name, level, pixel_center
        self.suffix = "flo" if level == "dense" else "npz"
        self.files = 0

    def path(self, camera, frame):
        return self.capture.root / "tracks" / self.name / camera / f"{frame:06d}.{self.suffix}"

    def write_tracks(self, camera, frame, source, target, visibility):
        """Motion from `frame` - 1 to `frame`: (N, 2) px, (N, 2) px, (N) 0 to 1."""
        arrays = {"src": source, "tgt": target, "visibility": visibility}
        arrays = {key: np.ascontiguousarray(value, np.float32) for key, value in arrays.items()}
        self._write(camera, frame, lambda file: np.savez(file, **arrays))

    def write_flow(self, camera, frame, flow):
        """Motion from `frame` - 1 to `frame` of every pixel (H, W, 2), px, as a Middlebury file."""
        flow = np.ascontiguousarray(flow, "<f4")
        if flow.ndim != 3 or flow.shape[2] != 2:
            raise LayoutError(f"flow of camera {camera}: shape {flow.shape} instead of (H, W, 2)")
        head = np.float32(202021.25).astype("<f4").tobytes() + np.array(flow.shape[1::-1], "<i4").tobytes()
        self._write(camera, frame, lambda file: file.write(head + flow.tobytes()))

    def _write(self, camera, frame, write):
        path = self.path(camera, frame)
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(path.name + ".part")
        with open(part, "wb") as file:
            write(file)
        os.replace(part, path)
        self.files += 1

    def register(self):
        """Adds the tracker to the list, or replaces the entry of its name."""
        if self.files == 0:
            raise LayoutError(f"tracker '{self.name}': no file of any camera was found, so nothing was written")
        file = self.capture.root / "tracks" / "tracks.json"
        index = json.loads(file.read_text()) if file.exists() else {"trackers": []}
        entry = {
            "name": self.name,
            "level": self.level,
            "format": self.suffix,
            "pattern": f"{self.name}/{{camera}}/{{frame:06}}.{self.suffix}",
            "pixel_center": self.pixel_center,
        }
        index["trackers"] = [t for t in index["trackers"] if t["name"] != self.name] + [entry]
        part = file.with_name("tracks.json.part")
        part.write_text(json.dumps(index, indent=2))
        os.replace(part, file)


def load(path):
    """Arrays of an .npz or, with torch, of a .pt file by name. A file with one array calls it `tracks`."""
    path = Path(path)
    if path.suffix == ".npz":
        with np.load(path) as file:
            return {key: file[key] for key in file.files}
    try:
        import torch
    except ImportError as error:
        raise LayoutError(f"{path}: .pt files are read by torch; pip install torch, or save .npz") from error
    data = torch.load(path, map_location="cpu", weights_only=True)
    data = data if isinstance(data, dict) else {"tracks": data}
    return {key: value.numpy() for key, value in data.items() if hasattr(value, "numpy")}


def files(folder, suffixes):
    """Files with one of the suffixes, by name."""
    return sorted(path for path in Path(folder).glob("*") if path.suffix in suffixes)
