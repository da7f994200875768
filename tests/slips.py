"""Boards with one slip each, as people make them, drawn at random; and their test bench in plain text."""

import re
import shutil
from pathlib import Path

import numpy as np

from cosim.circuits.boardgen import board_text

NETLISTS = Path(__file__).resolve().parents[1] / "netlists"
KINDS = (
    "inputs swapped", "feedback opened", "resistor x10", "resistor missing", "supplies crossed",
    "outputs exchanged",
)  # fmt: skip
#: Place of the output among the nodes of a block of the board.
OUTPUT = {"angle": 1, "diffamp": 2, "differentiator": 1, "summer": 1, "vca": 2}


def slipped(folder, seed):
    """Write a board with one slip into `folder`; return its file, its kind of drive and the slip in words.

    Joints 1 or 2, either drive, the slip in every instance of a block or, on the board, in one place.
    """
    rng = np.random.default_rng(seed)
    joints, drive = int(rng.integers(1, 3)), str(rng.choice(["voltage", "current"]))
    kind = KINDS[seed % len(KINDS)]
    target = Path(folder) / f"slip{seed}"
    shutil.copytree(NETLISTS / "parts", target / "parts")
    shutil.copytree(NETLISTS / "blocks", target / "blocks")
    board = target / "board.cir"
    board.write_text(board_text(joints))
    blocks = [target / "blocks" / f"{name}.cir" for name in
              ("angle", "diffamp", "differentiator", "summer", f"driver_{drive}")]  # fmt: skip
    if kind == "outputs exchanged":
        place = _exchange(board, rng)
    elif kind in ("resistor x10", "resistor missing"):
        file = blocks[1 + int(rng.integers(len(blocks) - 1))] if rng.random() < 0.8 else board
        place = _resistor(file, kind, rng)
    else:
        file = blocks[int(rng.integers(len(blocks)))]
        place = {"inputs swapped": _inputs, "feedback opened": _open, "supplies crossed": _supplies}[kind](
            file
        )
    return board, drive, f"{joints} joint(s), {drive}, {kind}: {place}"


def _rows(file):
    return file.read_text().split("\n")


def _amplifier(rows):
    return next(k for k, row in enumerate(rows) if row.startswith("xop "))


def _inputs(file):
    rows = _rows(file)
    at = _amplifier(rows)
    words = rows[at].split()
    words[1], words[2] = words[2], words[1]
    rows[at] = " ".join(words)
    file.write_text("\n".join(rows))
    return rows[at] + f" in {file.name}"


def _supplies(file):
    rows = _rows(file)
    at = _amplifier(rows)
    rows[at] = rows[at].replace("vcc vee", "vee vcc")
    file.write_text("\n".join(rows))
    return rows[at] + f" in {file.name}"


def _open(file):
    """Take whatever ties the inverting input to the output to ground instead."""
    rows = _rows(file)
    at = _amplifier(rows)
    words = rows[at].split()
    inverting, out = words[2], words[5]
    if inverting == out:
        words[2] = "lost"
        rows[at] = " ".join(words) + "\nRlost lost 0 1meg"
    else:
        for k, row in enumerate(rows):
            nodes = row.split()[1:3]
            if row[:1] in "RC" and inverting in nodes:
                # the current drive's loop comes back over the sense resistor
                rows[k] = re.sub(rf"(?<= )({out}|s)(?= )", "0", row, count=1)
    file.write_text("\n".join(rows))
    return f"around {rows[at]} in {file.name}".replace("\n", ", ")


def _resistor(file, kind, rng):
    rows = _rows(file)
    at = int(rng.choice([k for k, row in enumerate(rows) if row.startswith("R")]))
    words = rows[at].split()
    old = rows[at]
    if kind == "resistor x10":
        words[3] = f"{{10*({words[3].strip('{}')})}}"
        rows[at] = " ".join(words)
    else:
        rows[at] = ""
    file.write_text("\n".join(rows))
    return f"{old} in {file.name}"


def _exchange(board, rng):
    rows = _rows(board)
    values = [
        (k, 1 + OUTPUT[row.split()[-1]]) for k, row in enumerate(rows)
        if row.startswith("x") and row.split()[-1] in OUTPUT
    ]  # fmt: skip
    first, second = (values[int(k)] for k in rng.choice(len(values), 2, replace=False))
    words = {k: rows[k].split() for k, _ in (first, second)}
    (a, i), (b, j) = first, second
    words[a][i], words[b][j] = words[b][j], words[a][i]
    text = f"{rows[a]} / {rows[b]}"
    for k, row in words.items():
        rows[k] = " ".join(row)
    board.write_text("\n".join(rows))
    return text


def bench_text(board, gain):
    """Text of a flat deck on a bench: supplies, a source at every pin, gain pins at `gain` volts."""
    rows = board.text.split("\n")
    rows += ["Vcc vcc 0 15", "Vee vee 0 -15", f"Xboard {' '.join(board.pins)} {board.board}"]
    for pin in board.pins:
        if pin not in ("vcc", "vee") and not pin.startswith("imot"):
            rows.append(f"V{pin} {pin} 0 {gain if pin.startswith('ks') else 0}")
    return "\n".join(rows)
