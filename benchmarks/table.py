"""Figures for people."""

from __future__ import annotations

from typing import Any

from benchmarks.figure import TARGETS, Figure


def show(found: Figure) -> str:
    """Return a figure as a few lines of text."""
    _, unit, what = TARGETS[found.name]
    unit = f" {unit}" if unit else ""
    verdict = "met" if found.met else "MISSED"
    lines = [
        f"{found.name}: {found.ratio:.4g}{unit} (from {found.min:.4g} to {found.max:.4g}), "
        f"target {found.target:g}{unit}: {verdict}",
        f"    {what}",
    ]
    if found.error_ours is not None or found.error_peer is not None:
        ours, peer = ("-" if e is None else f"{e:.3g}" for e in (found.error_ours, found.error_peer))
        lines.append(f"    errors: ours {ours}, peer {peer} ({found.error_unit})")
    for key, value in found.details.items():
        lines += _detail(key, value)
    return "\n".join(lines)


def _detail(key: str, value: Any) -> list[str]:
    if isinstance(value, list):
        return [f"    {key}:", *(f"      {_text(entry)}" for entry in value)]
    return [f"    {key}: {_text(value)}"]


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, dict):
        return ", ".join(f"{key} {_text(entry)}" for key, entry in value.items())
    if isinstance(value, list | tuple):
        return " ".join(_text(entry) for entry in value)
    return str(value)
