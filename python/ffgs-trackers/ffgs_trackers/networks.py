"""Flow networks that are run here: torchvision's RAFT, and any network that was exported to ONNX."""

import numpy as np

from .layout import LayoutError

# Networks halve their input three times.
MULTIPLE = 8


def padded(image, multiple=MULTIPLE):
    """(H, W, 3) with its last rows and columns repeated up to a multiple."""
    height, width = image.shape[:2]
    return np.pad(image, ((0, -height % multiple), (0, -width % multiple), (0, 0)), mode="edge")


def run(capture, tracker, flow):
    """Writes `flow(before, now)` of every camera and step; both are (H, W, 3), 0 to 255."""
    for camera in capture.cameras():
        before = capture.image(camera, 0)
        for frame in range(1, capture.frames):
            now = capture.image(camera, frame)
            if before is not None and now is not None:
                height, width = now.shape[:2]
                found = flow(padded(before), padded(now))
                tracker.write_flow(camera, frame, found[:height, :width])
            before = now


def raft():
    """torchvision's RAFT with its own weights."""
    try:
        import torch
        from torchvision.models.optical_flow import Raft_Large_Weights, raft_large
    except ImportError as error:
        raise LayoutError("RAFT needs torchvision; pip install torch torchvision") from error
    device = "cuda" if torch.cuda.is_available() else "cpu"
    model = raft_large(weights=Raft_Large_Weights.DEFAULT).eval().to(device)

    def tensor(image):
        values = np.array(image.transpose(2, 0, 1)[None], np.float32) / 127.5 - 1.0
        return torch.from_numpy(values).to(device)

    def flow(before, now):
        with torch.no_grad():
            return model(tensor(before), tensor(now))[-1][0].permute(1, 2, 0).cpu().numpy()

    return flow


def onnx(path, scale, offset):
    """A network with two images (1, 3, H, W) as inputs and the flow (1, 2, H, W) as its last output."""
    try:
        import onnxruntime
    except ImportError as error:
        raise LayoutError("ONNX networks need onnxruntime; pip install onnxruntime") from error
    session = onnxruntime.InferenceSession(str(path), providers=onnxruntime.get_available_providers())
    inputs = [entry.name for entry in session.get_inputs()]
    if len(inputs) != 2:
        raise LayoutError(f"{path}: {len(inputs)} inputs ({', '.join(inputs)}) instead of two images")

    def flow(before, now):
        images = [(i.transpose(2, 0, 1)[None] * scale + offset).astype(np.float32) for i in (before, now)]
        return session.run(None, dict(zip(inputs, images, strict=True)))[-1][0].transpose(1, 2, 0)

    return flow
