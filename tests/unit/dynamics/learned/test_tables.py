"""Tables of users: columns read by name or by a map, units, and messages on bad tables."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from dynamics.learned.files import read_table
from dynamics.learned.transitions import Transitions
from dynamics.systems import signals

SIGNALS = signals("x [m]; v [m/s]"), signals("u [N]")
COLUMNS = ("x", "v", "u", "x_next", "v_next")


def steps(n: int = 50) -> np.ndarray:
    """Draw n rows of x, v, u, x_next, v_next."""
    x, v, u = np.random.default_rng(2).standard_normal((3, n))
    return np.stack([x, v, u, x + 0.1 * v, v + 0.1 * u], axis=1)


def write(path: Path, heads: tuple[str, ...] = COLUMNS, rows: np.ndarray | None = None) -> Path:
    """Write the steps as CSV or Parquet with all digits and reversed columns; return the path."""
    import pandas as pd

    frame = pd.DataFrame(steps() if rows is None else rows, columns=list(heads))
    frame = frame[frame.columns[::-1]]
    if path.suffix == ".csv":
        frame.to_csv(path, index=False)
    else:
        frame.to_parquet(path)
    return path


def is_whole(data: Transitions) -> None:
    assert np.array_equal(np.hstack([data.x, data.u, data.x_next]), steps())


@pytest.mark.parametrize("name", ["data.csv", "data.parquet"])
def test_columns_are_found_by_name(tmp_path: Path, name: str) -> None:
    data = read_table(write(tmp_path / name), signals=SIGNALS, provenance={"problem": "own"})
    is_whole(data)
    assert (data.states, data.inputs) == SIGNALS
    assert data.provenance == {"how": f"read from {name}", "problem": "own"}


def test_a_map_names_them_otherwise(tmp_path: Path) -> None:
    heads = ("position [m]", "speed", "force", "then", "v_next")
    file = write(tmp_path / "data.csv", heads)
    names = {"x": "position", "v": "speed", "u": "force", "x_next": "then"}
    is_whole(read_table(file, names, SIGNALS))
    is_whole(read_table(file, {**names, "x": "position [m]"}, SIGNALS))
    # Without a problem the map says what there is: v_next is no column of its own then.
    data = read_table(file, {"a": "position", "a_next": "then", "b": "force"})
    assert [s.name for s in data.states] == ["a"] and [s.unit for s in data.states] == ["m"]
    assert [s.name for s in data.inputs] == ["b"]


def test_units_in_brackets_are_read_and_compared(tmp_path: Path) -> None:
    heads = ("x [m]", "v [m/s]", "u [N]", "x_next [m]", "v_next")
    file = write(tmp_path / "data.csv", heads)
    is_whole(read_table(file, signals=SIGNALS))
    alone = read_table(write(tmp_path / "other.csv", heads))
    assert set(alone.states) == set(SIGNALS[0]) and alone.inputs == SIGNALS[1]
    with pytest.raises(ValueError, match=r"column 'x \[m\]' is in m, and x is in mm; convert it"):
        read_table(file, signals=(signals("x [mm]; v [m/s]"), SIGNALS[1]))


def test_missing_columns_are_told(tmp_path: Path) -> None:
    file = write(tmp_path / "data.csv")
    with pytest.raises(ValueError, match=r"no column for w \[N\]; it has .*map one with columns w="):
        read_table(file, signals=(SIGNALS[0], signals("w [N]")))
    with pytest.raises(ValueError, match=r"no column for q_next \[1\]"):
        read_table(file, {"q": "x"}, (signals("q"), SIGNALS[1]))
    with pytest.raises(ValueError, match="no column 'y' for x; available: v_next, x_next"):
        read_table(file, {"x": "y"}, SIGNALS)
    with pytest.raises(ValueError, match="no column is the next state of another; name states"):
        read_table(write(tmp_path / "b.csv", ("a", "b", "c", "d", "e")))
    with pytest.raises(ValueError, match="two columns are called x; rename one"):
        read_table(write(tmp_path / "c.csv", ("x", "x [m]", "u", "x_next", "v_next")))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is empty; the first line must name the columns"),
        ("x,u,x_next\n1,2,3\n1,2,3,4,5\n", "is not a CSV table: "),
        ("x,u,x_next\n1,two,3\n", "column 'u' holds 'two' in row 0, counted from 0, which is"),
        ("x,u,x_next\n" + "1,2,3\n" * 10, "10 rows are too few"),
        ("x,u,x_next\n" + "".join(f"{i},,{i}\n" for i in range(20)), "u is nan in row 0"),
        ("x,u,x_next\n" + "".join(f"{i},7,{i}\n" for i in range(20)), "u never varies"),
    ],
)
def test_tables_that_are_none_are_told(tmp_path: Path, content: str, message: str) -> None:
    file = tmp_path / "data.csv"
    file.write_text(content)
    with pytest.raises(ValueError, match=message):
        read_table(file)


def test_files_that_are_no_tables_are_told(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="file not found"):
        read_table(tmp_path / "none.csv")
    with pytest.raises(ValueError, match=r"expected a table, \.csv or \.parquet"):
        read_table(tmp_path / "data.txt")
    for name in ("data.parquet", "data.csv"):
        (tmp_path / name).write_bytes(b"\xff\xfe\x00PAR1")
    with pytest.raises(ValueError, match="is not a complete Parquet file"):
        read_table(tmp_path / "data.parquet")
    with pytest.raises(ValueError, match="is not UTF-8 text"):
        read_table(tmp_path / "data.csv")


def test_parquet_without_arrow_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = write(tmp_path / "data.parquet")
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(ValueError, match=r"the extra learn installs: .* or write the table as CSV"):
        read_table(file)
