"""The table of `python -m tests.bench --bounds`."""

import pytest
from bench.bounds import show_taken

TAKEN = {
    "touching": [1.0],
    "the last step of computing them alone": [2.0],
    "computing them": [4.0, 6.0, 5.0],
    "bound: one": [8.0],
    "stage: one": [20.0],
}


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"figaroh": [40.0]}, ["     4.00      5.00         5.0      0.125  computing them", "10.0 ms, 0.250 of figaroh: one pass"]),
        ({}, ["     4.00      5.00         5.0          –  computing them", "10.0 ms: one pass", "20.0 ms: the stages above"]),
    ],
    ids=["with figaroh", "without figaroh"],
)
def test_ratios_to_figaroh_are_left_out_where_it_is_absent(capsys, more, says):
    """Figures are there, or a dash; no figure is made up of nothing."""
    show_taken({**TAKEN, **more})
    shown = capsys.readouterr().out
    assert all(text in shown for text in says), shown
    assert "nan" not in shown
