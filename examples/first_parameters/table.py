"""Prints the table of README.md from the results of the study in this folder."""

import json
import sys
from pathlib import Path

file = Path(sys.argv[1] if len(sys.argv) > 1 else "build/sweeps/study/analysis.json")
findings = json.loads(file.read_text(encoding="utf-8"))["findings"]
rows: dict[str, dict[str, float]] = {}
for finding in findings:
    for effect in finding["sensitivity"]["effects"]:
        share = effect["estimates"]["mu_star"]["value"] / finding["spread"]["mean"]
        rows.setdefault(effect["name"], {})[finding["name"]] = 100 * share
names = [finding["name"] for finding in findings]
print("|parameter|" + "|".join(names) + "|")
print("|---" * (len(names) + 1) + "|")
for parameter, shares in sorted(rows.items(), key=lambda row: -max(row[1].values())):
    print(f"|`{parameter}`|" + "|".join(f"{shares[name]:.1f}" for name in names) + "|")
