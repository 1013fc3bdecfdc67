from pathlib import Path

from check_modules import too_long, tracked


def test_a_module_of_401_lines_is_too_long_and_one_of_400_is_not(tmp_path: Path):
    long, short = tmp_path / "long.py", tmp_path / "short.py"
    long.write_text("x = 1\n" * 401, encoding="utf-8")
    short.write_text("x = 1\n" * 400, encoding="utf-8")
    (problem,) = too_long([long, short])
    assert "long.py: 401 lines" in problem


def test_this_file_is_among_the_tracked_ones():
    assert Path(__file__).resolve() in tracked("*.py")
