"""Figures for people."""

from __future__ import annotations

from typing import Any

from benchmarks.figure import TARGETS, Figure


def show(figure: Figure) -> str:
    """Return a figure as a few lines of text."""
    _, unit, what = TARGETS[figure.name]
    unit = f" {unit}" if unit else ""
    verdict = "met" if figure.met else "MISSED"
    lines = [
        f"{figure.name}: {figure.ratio:.4g}{unit} (from {figure.min:.4g} to {figure.max:.4g}), "
        f"target {figure.target:g}{unit}: {verdict}",
        f"    {what}",
    ]
    if figure.error_ours is not None or figure.error_peer is not None:
        ours, peer = ("-" if e is None else f"{e:.3g}" for e in (figure.error_ours, figure.error_peer))
        lines.append(f"    errors: ours {ours}, peer {peer} ({figure.error_unit})")
    for key, value in figure.details.items():
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
