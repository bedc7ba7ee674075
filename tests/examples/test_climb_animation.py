"""The animation in the README."""

from PIL import Image

from examples import climb_animation
from tests import ROOT


def test_the_climb_is_drawn(tmp_path):
    result = climb_animation.main(["--out", str(tmp_path / "climb.gif"), "--width", "64"])
    shown = Image.open(ROOT / "docs" / "figures" / "climb.gif")
    assert result["steps"] == 12 and Image.open(tmp_path / "climb.gif").n_frames == shown.n_frames
    assert (ROOT / "docs" / "figures" / "climb.gif").stat().st_size < 2e6
