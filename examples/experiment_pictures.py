"""Pictures of MLflow's page for docs/experiments.md: the table of a sweep with four runs, and its curves.

    python -m examples.experiment_pictures [--out docs/figures] [--chromium /usr/bin/chromium] [--folder FOLDER]

Minutes: labels of a few hundred maps, four short trainings. Needs `pip install 'hdsp[pipeline]' playwright` and
Chromium. `--folder` keeps labels and runs; a second call with it takes the pictures alone.
"""

from __future__ import annotations

import argparse
import io
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hdsp.base.errors import InputError
from hdsp.base.files import replacing
from pipeline.run_view import ADDRESS

MAPS = {"train": 24, "val": 6, "random": 6}  # of each category
SWEEP = ["model=compact,swept", "trainer.optimizer.lr=0.003,0.001", "trainer.epochs=8"]
WIDTH, HEIGHT = 1600, 560
SECONDS = 120  # of patience


def main(argv=None) -> list[Path]:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("docs/figures"))
    parser.add_argument("--chromium", default=shutil.which("chromium"))
    parser.add_argument("--folder", type=Path, help="place for labels and runs; none = a folder that is removed")
    arguments = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as temporary:
        folder = (arguments.folder or Path(temporary)).resolve()
        if not (folder / "mlflow.db").is_file():
            swept(folder)
        with served(folder) as address:
            made = pictures(address, arguments.out, arguments.chromium)
    for path in made:
        print(path)
    return made


def swept(folder: Path) -> None:
    """Labels a few maps and trains four networks."""
    folder.mkdir(parents=True, exist_ok=True)
    sizes = [f"labelling.splits.{split}.maps_per_category={maps}" for split, maps in MAPS.items()]
    common = ["profile=tiny", f"runtime.inputs={folder}", *sizes]
    for split in MAPS:
        run("pipeline.label", split, *common, f"runtime.outputs={folder}", folder=folder)
    run("pipeline.train", "-m", *common, *SWEEP, f"hydra.sweep.dir={folder / 'sweep'}", folder=folder)


def run(*arguments: str, folder: Path) -> None:
    """Runs a stage whose tracking database lies in the folder."""
    subprocess.run([sys.executable, "-m", *arguments], env={**os.environ, "DVC_ROOT": str(folder)}, check=True)


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """The address of MLflow's page, as long as the context is open."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address, database = f"http://127.0.0.1:{port}", f"sqlite:///{folder / 'mlflow.db'}"
    command = [sys.executable, "-m", "mlflow", "ui", "--backend-store-uri", database, "--port", str(port)]
    server = subprocess.Popen([*command, "--workers", "1"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        for _ in range(2 * SECONDS):
            try:
                urllib.request.urlopen(f"{address}/health").close()
                break
            except OSError:
                time.sleep(0.5)
        else:
            raise InputError(f"MLflow's page does not answer at {address} within {SECONDS} s")
        yield address
    finally:
        server.terminate()
        server.wait()


def pictures(address: str, folder: Path, chromium: str | None) -> list[Path]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
        page.set_default_timeout(1000 * SECONDS)
        page.goto(f"{address}/{ADDRESS}")
        page.wait_for_selector(".ag-row")
        page.get_by_label("Close", exact=True).first.click()  # the panel of MLflow's assistant
        made = [picture(page, folder / "mlflow_runs.png")]
        page.goto("about:blank")
        page.set_viewport_size({"width": WIDTH, "height": 1130})
        page.goto(f"{address}/{ADDRESS}&compareRunsMode=CHART")
        page.get_by_placeholder("Search metric charts").fill("accuracy/val")
        page.wait_for_selector(".js-plotly-plot")
        made.append(picture(page, folder / "mlflow_curves.png"))
        browser.close()
    return made


def picture(page, path: Path) -> Path:
    """Takes a picture after the page has settled, with few colours, so that the file is small."""
    from PIL import Image

    time.sleep(8)
    taken = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    with replacing(path) as temporary:
        taken.quantize(256, dither=Image.Dither.NONE).save(temporary, format="png", optimize=True)
    return path


if __name__ == "__main__":
    main()
