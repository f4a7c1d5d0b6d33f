"""The choice of a friction law: what each law misses on data left out, from factors, is what fits to the rows themselves miss."""

import numpy as np
import pytest

from monitor.identify.fit.fit import errors_left_out
from monitor.identify.fit.least_squares import Factor, triangle

ROWS, COLUMNS = 60, 12


def stretches(rng, hidden=()):
    """Rows of stretches, the last column the torque; the columns `hidden` are zero in all of them."""
    parts = [rng.normal(size=(ROWS, COLUMNS + 1)) for _ in range(5)]
    for part in parts:
        part[:, -1] += part[:, :-1] @ np.arange(COLUMNS)
        part[:, list(hidden)] = 0.0
    return parts


@pytest.mark.parametrize("chosen", [(0, 1, 2, 3, 4), tuple(range(COLUMNS)), (0, 1, 2, 8, 9)], ids=["the first", "all", "not the first"])
@pytest.mark.parametrize("hidden", [(), (2,)], ids=["all excited", "one never excited"])
def test_a_law_is_tested_on_each_stretch_by_its_fit_to_all_others(chosen, hidden):
    parts = stretches(np.random.default_rng(1), hidden)
    columns = np.array([*chosen, COLUMNS])
    folds = [Factor(triangle(part), ROWS) for part in parts]
    found = errors_left_out(folds, columns, np.zeros(len(chosen)))
    for k, part in enumerate(parts):
        others = np.concatenate(parts[:k] + parts[k + 1 :])[:, columns]
        values = np.linalg.lstsq(others[:, :-1], others[:, -1], rcond=1e-9)[0]
        left = part[:, columns] @ np.append(values, -1.0)
        assert found[k] == pytest.approx(np.mean(left**2), rel=1e-10)
