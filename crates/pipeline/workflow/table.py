"""One table over all runs of a workflow, in Markdown: table.py config.json."""

import json
import sys
from pathlib import Path

HEAD = ["run", "frames", "PSNR", "MPSNR", "SSIM", "VMAF", "s per frame", "peak MiB", "largest jump at a seam, MPSNR"]


def number(value, digits=2):
    return "-" if value is None else f"{value:.{digits}f}"


class Run:
    """What a finished run says of itself."""

    def __init__(self, name, run, root):
        self.name = name
        self.folder = root / name / ("joined" if run["parts"] else "")
        self.metrics = json.loads((self.folder / "metrics.json").read_text())
        self.seams = json.loads((self.folder / "seams.json").read_text()) if run["parts"] else []

    def cells(self):
        """Those of `HEAD`, but for the first."""
        mean, frames = self.metrics["mean"], self.metrics["frames"]
        used = [frame["peak_memory_mib"] for frame in frames if frame.get("peak_memory_mib")]
        jumps = [abs(seam["mpsnr"][1] - seam["mpsnr"][0]) for seam in self.seams if None not in seam["mpsnr"]]
        # Of a capture without test views: of views that were trained on.
        quality = self.metrics.get("mean_training_views") or mean
        return [
            str(len(frames)) + (", training views" if quality is not mean else ""),
            *(number(quality[key]) for key in ("psnr", "mpsnr")),
            number(quality["ssim"], 4),
            number(mean["vmaf"]),
            number(mean["seconds_per_frame"]),
            number(max(used, default=None), 0),
            number(max(jumps, default=None)),
        ]


def line(cells):
    return "| " + " | ".join(cells) + " |"


def main(config):
    root = config.resolve().parent
    print(line(HEAD))
    print("|" + "---|" * len(HEAD))
    for name, run in json.loads(config.read_text())["runs"].items():
        of_run = Run(name, run, root)
        print(line([f"[{name}]({of_run.folder.relative_to(root)}/report.html)", *of_run.cells()]))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
