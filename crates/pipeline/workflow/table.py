"""One table over all runs of a workflow, in Markdown: table.py config.json."""

import json
import sys
from pathlib import Path


def number(value, digits=2):
    return "-" if value is None else f"{value:.{digits}f}"


def row(name, run, root):
    folder = root / name / ("joined" if run["parts"] else "")
    metrics = json.loads((folder / "metrics.json").read_text())
    mean, frames = metrics["mean"], metrics["frames"]
    used = [frame["peak_memory_mib"] for frame in frames if frame.get("peak_memory_mib")]
    seams = json.loads((folder / "seams.json").read_text()) if run["parts"] else []
    jumps = [abs(seam["mpsnr"][1] - seam["mpsnr"][0]) for seam in seams if None not in seam["mpsnr"]]
    cells = [
        f"[{name}]({folder.relative_to(root)}/report.html)",
        str(len(frames)),
        *(number(mean[key]) for key in ("psnr", "mpsnr")),
        number(mean["ssim"], 4),
        number(mean["vmaf"]),
        number(mean["seconds_per_frame"]),
        number(max(used, default=None), 0),
        number(max(jumps, default=None)),
    ]
    return "| " + " | ".join(cells) + " |"


def main(config):
    print("| run | frames | PSNR | MPSNR | SSIM | VMAF | s per frame | peak MiB | largest jump at a seam, MPSNR |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name, run in json.loads(config.read_text())["runs"].items():
        print(row(name, run, config.resolve().parent))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
