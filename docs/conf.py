"""The documentation as a site, made by Sphinx: `make docs`, then open build/site/index.html.

The source folder is the project's root: documents stay next to what they describe, and their links work on a
git server as well. Nothing comes from other servers.
"""

from __future__ import annotations

import sys
from pathlib import Path

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS.parent), str(DOCS / "site")]

project = "harvester-cosim"
author = "harvester-cosim"
copyright = "harvester-cosim contributors, MIT licence"
language = "en"

extensions = ["myst_parser", "sphinx.ext.autodoc", "extension"]
root_doc = "docs/index"
source_suffix = {".md": "markdown", ".ipynb": "markdown"}
include_patterns = [
    "examples/notebook/*.ipynb",
    *("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "NOTICES.md"),
    *("docs/**.md", "fmus/**/README.md", "fmus/README.md", "orchestrator/README.md", "examples/*/README.md"),
]
exclude_patterns = ["build", ".*"]

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
default_role = "literal"
smartquotes = False

autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "signature"
add_module_names = False

html_theme = "furo"
html_title = "harvester-cosim"
html_math_renderer = "mathml"
html_static_path = ["site/assets"]
html_css_files = ["site.css"]
html_search_scorer = "docs/site/search_scorer.js"
html_show_search_summary = False  # a page opened as a file may not read the others
html_copy_source = False
html_show_sphinx = False
html_theme_options = {
    "sidebar_hide_name": False,
    "navigation_with_keys": True,
    "light_css_variables": {"color-brand-primary": "#1f5c43", "color-brand-content": "#1c6b4c"},
    "dark_css_variables": {"color-brand-primary": "#8fd6b4", "color-brand-content": "#8fd6b4"},
}
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"

# captions of the sidebar and their pages, from the project's root
NAVIGATION = {
    "Start": [
        "What it is <README.md>",
        "docs/tutorials/first-run.md",
        "docs/tutorials/index.md",
        "examples/notebook/first_ten_minutes.ipynb",
        "docs/troubles.md",
        "docs/glossary.md",
        "CHANGELOG.md",
    ],
    "Tutorials": [
        "docs/tutorials/use-the-fmus.md",
        "docs/tutorials/swap-fidelity.md",
        "docs/tutorials/measurements.md",
        "docs/tutorials/crane.md",
        "docs/tutorials/diagnosis.md",
        "docs/tutorials/subsystem.md",
        "docs/tutorials/control.md",
        "docs/tutorials/sweep.md",
    ],
    "Use the FMUs": [
        "docs/other-tools.md",
        "examples/simulink/README.md",
        "examples/modelica/README.md",
        "docs/rate-ports.md",
        "docs/check.md",
    ],
    "Model": [
        "docs/machine.md",
        "docs/equations.md",
        "docs/fidelity.md",
        "FMU swing <fmus/swing/README.md>",
        "FMU boom_stick <fmus/boom_stick/README.md>",
        "FMU manipulator <fmus/manipulator/README.md>",
        "FMU supply <fmus/supply/README.md>",
        "FMU operator_input <fmus/operator_input/README.md>",
        "FMU valve_actuation <fmus/valve_actuation/README.md>",
        "FMU controller <fmus/controller/README.md>",
        "FMU harvester <fmus/machine/harvester/README.md>",
        "fmus/README.md",
    ],
    "Co-simulation": [
        "docs/run.md",
        "docs/python.md",
        "docs/coupling.md",
        "docs/convergence.md",
        "orchestrator/README.md",
    ],
    "Identification": ["docs/identification.md", "docs/recordings.md", "fmus/identification/README.md"],
    "Control, driving, studies": [
        "docs/control.md",
        "docs/crane.md",
        "docs/diagnosis.md",
        "docs/patu.md",
        "docs/faults.md",
        "docs/linearize.md",
        "docs/view.md",
        "docs/sweep.md",
        "docs/cluster.md",
    ],
    "Examples": [
        "examples/fidelity/README.md",
        "examples/my_subsystem/README.md",
        "examples/hydraulic_manipulator/README.md",
        "examples/grey_box/README.md",
        "examples/measured_cylinder/README.md",
        "examples/paper_section_4/README.md",
        "examples/swing_peaks/README.md",
        "examples/first_parameters/README.md",
        "examples/faults/README.md",
    ],
    "Reference": [
        "docs/reference/index.md",
        "docs/reference/commands.md",
        "docs/reference/variants.md",
        "docs/reference/ports.md",
        "docs/reference/parameters.md",
        "docs/reference/check-rules.md",
        *sorted(f"docs/reference/api/{p.name}" for p in (DOCS / "reference" / "api").glob("*.md")),
    ],
    "Development": ["docs/design.md", "CONTRIBUTING.md", "NOTICES.md"],
}
