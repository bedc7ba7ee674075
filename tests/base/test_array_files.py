"""Arrays from NumPy's files: text in a damaged file."""

import numpy as np
import pytest

from hdsp.base.array_files import npz_arrays
from hdsp.base.errors import InputError


@pytest.mark.parametrize("order", "<>")
def test_text_with_numbers_that_stand_for_no_character_is_refused(tmp_path, order):
    text = np.array("facts\U0010ffff", f"{order}U6")
    np.savez(tmp_path / "whole.npz", text=text, texts=np.array(["a", ""]), empty=np.array([], "U3"))
    assert str(npz_arrays(tmp_path / "whole.npz", 1000)["text"]) == "facts\U0010ffff"
    numbers = np.frombuffer(text.tobytes(), f"{order}u4").copy()
    numbers[2] = 0x110000
    np.savez(tmp_path / "damaged.npz", text=np.frombuffer(numbers.tobytes(), text.dtype).reshape(()))
    with pytest.raises(InputError, match="text with the character number 1,114,112"):
        npz_arrays(tmp_path / "damaged.npz", 1000)
