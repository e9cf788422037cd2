"""A user's file for the tests: a first-order lag, as text to be changed."""

from pathlib import Path

from fmus.export.python.build import build_user

LAG = Path(__file__).with_suffix(".txt").read_text(encoding="utf-8")


def written(folder: Path, *changes: tuple[str, str], name: str = "lag.py") -> Path:
    """The file with some of its text replaced."""
    text = LAG
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def built(folder: Path, *changes: tuple[str, str], name: str = "lag.py", fmi: int = 2) -> Path:
    """An FMU of such a file."""
    return build_user(written(folder, *changes, name=name), folder / "out", fmi=fmi)
