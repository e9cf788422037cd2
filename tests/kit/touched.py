"""What a change touches: the shards that `.ci/run` runs whole, and the tests that begin them.

    python tests/kit/touched.py FILE

prints the shards in the order in which they run, each with the part whose turn it is, and whether the whole
shard runs; and writes the changed files to FILE, for `pytest --first FILE`. touched.toml says which files
touch which shard.

A change is the difference to the last landing. That is the commit at which it left origin/main; else the one
that .ci/landed names; else the oldest of the last commits. An older one only runs more.
"""

import re
import subprocess
import sys
import tomllib
from collections.abc import Collection, Mapping
from fnmatch import fnmatchcase
from pathlib import Path

ROOT = Path(__file__).parents[2]
SHARDS = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
LANDED = ".ci/landed"  # commit of the last landing
LAST = 100  # commits, if no landing is known


def git(root: Path, *arguments: str) -> str:
    """What git prints; nothing if it fails, as for a commit that a shallow clone lacks."""
    done = subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, check=False)
    return "" if done.returncode else done.stdout.strip()


def last_landing(root: Path = ROOT) -> tuple[str, str]:
    """The commit that the change is compared with, and how it is known."""
    head, file = git(root, "rev-parse", "HEAD"), root / LANDED
    named = file.read_text(encoding="utf-8").strip() if file.is_file() else ""
    for other, how in (("origin/main", "at which it left origin/main"), (named, f"in {LANDED}")):
        fork = other and git(root, "merge-base", "HEAD", other)
        if fork and fork != head:
            return fork, how
    commits = git(root, "rev-list", f"--max-count={LAST + 1}", "HEAD").split()
    return commits[-1], f"the oldest of the last {len(commits)}, as no landing is known"


def changed(root: Path, base: str) -> list[str]:
    """Files that differ from a commit, also those that are gone."""
    return git(root, "diff", "--name-only", "--no-renames", base).splitlines()


def touched(files: Collection[str], tests: Mapping[str, str]) -> set[str]:
    """Shards that changed files touch; tests: the text of each file of tests that is there."""
    found = set[str]()
    for name, shard in SHARDS.items():
        own = {path for path, text in tests.items() if f"shards.{name}" in text}
        own |= {path.replace(".py", ".toml") for path in own}
        if own & {*files} or any(fnmatchcase(file, p) for file in files for p in shard["by"]):
            found.add(name)
    return found


def plan(whole: Collection[str], turn: int) -> list[tuple[str, str, str]]:
    """Shards, the part whose turn it is, and "whole" or "part"; those that run whole are first."""
    order = sorted(SHARDS, key=lambda name: name not in whole)
    part = {name: f"{turn % shard['parts']}/{shard['parts']}" for name, shard in SHARDS.items()}
    return [(name, part[name], "whole" if name in whole else "part") for name in order]


def is_touched(nodeid: str, files: Collection[str]) -> bool:
    """Is a test in a changed file, beside a changed table, or one of a changed page or example?"""
    path, _, case = nodeid.partition("::")
    values = {*re.split(r"[^\w./-]+", case.partition("[")[2].removesuffix("]"))}
    own = {path, path.removesuffix(".py") + ".toml"}
    return any(file in own | values or Path(file).stem in values for file in files)


def main() -> None:
    """See the head of the file."""
    base, how = last_landing()
    files = changed(ROOT, base)
    Path(sys.argv[1]).write_text("\n".join(files), encoding="utf-8")
    print(f"the change since {base[:8]}, {how}: {len(files)} files", file=sys.stderr)
    paths = (ROOT / "tests").rglob("test_*.py")
    tests = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in paths}
    for row in plan(touched(files, tests), int(git(ROOT, "rev-list", "--count", "HEAD"))):
        print(*row)


if __name__ == "__main__":
    main()
