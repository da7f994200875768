"""The floors of the house: a room imports only from floors below it.

Run as a script it draws them into ARCHITECTURE.md.
"""

from itertools import pairwise
from pathlib import Path

#: Floor of a module, by the longest prefix that fits.
FLOORS = {
    "mech": 0,
    "cosim": 0,
    "cosim.errors": 0,
    "cosim.caution": 0,
    "cosim.assets": 0,
    "cosim.catalogue": 0,
    "cosim.notebook_view": 0,
    "cosim.quick_start": 0,
    "cosim.terminal": 0,
    "cosim.types": 0,
    "cosim.units": 0,
    "cosim.storage": 0,
    "cosim.scene": 0,
    "cosim.ngspice": 0,
    "cosim.circuits": 1,
    "cosim.provenance": 1,
    "cosim.results": 1,
    "cosim.loop": 2,
    "cosim.effects": 2,
    "cosim.plan": 2,
    "cosim.stability_gate": 2,
    "cosim.pose_matrices": 2,
    "cosim.coupled_poles": 2,
    "cosim.plausibility": 2,
    "cosim.measures": 2,
    "cosim.newproject": 2,
    "cosim.runner": 3,
    "cosim.export": 3,
    "cosim.checking": 3,
    "cosim.analysis": 3,
    "cosim.comparisons": 4,
    "cosim.studies": 5,
    "cosim.tolerance": 5,
    "cosim.accuracy": 5,
    "cosim.api": 6,
    "reports": 6,
    "cosim.commands": 7,
    "cosim.cli": 7,
    "cosim.__main__": 7,
}
#: Floors whose rooms may import from one another.
TOGETHER = (0, 1, 2, 5, 7)
#: What a room is for, in a few words: the rooms of the picture in ARCHITECTURE.md.
WORDS = {
    "mech": "linkages, friction, operators; no circuit",
    "cosim.storage": "files and folders, whole or not at all",
    "cosim.scene": "scene files, checked",
    "cosim.ngspice": "decks, safety, the child process",
    "cosim.circuits": "extraction, fits, instability; no mechanics",
    "cosim.results": "a run on disk",
    "cosim.loop": "computer, events, two time loops",
    "cosim.effects": "what a scene may switch on",
    "cosim.plan": "scene and board, resolved",
    "cosim.plausibility": "likely mistakes in inputs and results",
    "cosim.measures": "figures of a run",
    "cosim.runner": "plan -> run",
    "cosim.export": "plain ngspice decks",
    "cosim.checking": "a board judged",
    "cosim.analysis": "theory of a held contact",
    "cosim.comparisons": "many runs of one scene",
    "cosim.studies": "the paper's studies",
    "cosim.tolerance": "Monte Carlo",
    "cosim.accuracy": "accuracy against time",
    "cosim.api": "functions of the front door",
    "reports": "figures and pages",
    "cosim.commands": "the command line",
}
_BEGIN, _END = "<!-- floors: written by `python tests/floors.py` -->", "<!-- end of floors -->"


def picture() -> str:
    """Return the floors as a Mermaid flowchart, the highest first."""
    lines = ["```mermaid", "flowchart TB"]
    floors = sorted({FLOORS[name] for name in WORDS}, reverse=True)
    for floor in floors:
        lines.append(f'  subgraph F{floor}["floor {floor}"]')
        lines += [
            f'    {name.replace(".", "_")}["{name}<br/>{words}"]'
            for name, words in WORDS.items()
            if FLOORS[name] == floor
        ]
        lines.append("  end")
    lines += [f"  F{above} --> F{below}" for above, below in pairwise(floors)]
    return "\n".join([*lines, "```"])


def with_picture(text: str) -> str:
    """Return the page with the picture as it is now."""
    before, _, rest = text.partition(_BEGIN)
    return f"{before}{_BEGIN}\n{picture()}\n{_END}{rest.partition(_END)[2]}"


if __name__ == "__main__":
    PAGE = Path(__file__).resolve().parents[1] / "ARCHITECTURE.md"
    PAGE.write_text(with_picture(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
