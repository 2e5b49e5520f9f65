"""Train and score the network.

    python -m horizonval_learned train FRAMES
    python -m horizonval_learned score FRAMES BENCH results/learned

FRAMES is a folder of ``horizonval dataset learning --frames 10000 --out FRAMES --format hdf5``, BENCH one of
``horizonval bench make --out BENCH``. ``train`` writes the
weights into the package, ``score`` the page, its numbers and its picture.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

PAGE, NUMBERS, PICTURE = "README.md", "learned.json", "errors.png"


def main() -> None:
    """Do what the command line says."""
    text = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("python -m horizonval_learned", description=__doc__, formatter_class=text)
    commands = parser.add_subparsers(dest="command", required=True)
    learn = commands.add_parser("train", help="make the weights; needs torch and h5py")
    learn.add_argument("frames", type=Path)
    learn.add_argument("--seed", type=int, default=1)
    judge = commands.add_parser("score", help="write the page; needs h5py and the package of examples/peers")
    judge.add_argument("frames", type=Path)
    judge.add_argument("bench", type=Path)
    judge.add_argument("folder", type=Path)
    judge.add_argument("--work", type=Path, default=Path("out-learned"), help="for the suites' runs")
    arguments = parser.parse_args()
    if arguments.command == "train":
        from horizonval_learned.train import train

        train(arguments.frames, arguments.seed, report=print)
        return
    score(arguments.frames, arguments.bench, arguments.folder, arguments.work)


def score(frames: Path, bench: Path, folder: Path, work: Path) -> None:
    """Write the page, its numbers and its picture into a folder."""
    from horizonval_peers.threshold_circle import OTSU, TRIANGLE

    from horizonval.plugins import registry
    from horizonval_learned.page import page
    from horizonval_learned.plot import plot
    from horizonval_learned.plugin import ESTIMATOR
    from horizonval_learned.score import ON_SAMPLE, digest_of

    methods = [ESTIMATOR, TRIANGLE, OTSU, *(registry.get(name) for name in ON_SAMPLE)]
    digest = digest_of(frames, bench, methods, work, report=print)
    folder.mkdir(parents=True, exist_ok=True)
    plot(digest, folder / PICTURE)
    # Single errors are for the picture; the page and the file of numbers have what they come to.
    del digest["test"]["errors_deg"], digest["test"]["normalised"]
    (folder / NUMBERS).write_text(json.dumps(digest, indent=1) + "\n", encoding="utf-8")
    (folder / PAGE).write_text(page(digest), encoding="utf-8")


if __name__ == "__main__":
    main()
