"""Rendered over commanded stiffness and damping, with what a hand notices shaded."""

import numpy as np
from matplotlib.axes import Axes

from cosim.studies import table_columns as col
from cosim.studies.study import StudyResult
from reports.style import CONTACT, JOINTS, WALL, Drawn, figure

__all__ = ["draw"]

_DASHES = ("-", (0, (6, 2)), (0, (3, 2)), (0, (1, 1.2)), (0, (6, 2, 1, 2)))
_PLACES = (
    (col.STIFFNESS_SHARE, "Spring alone: K/k", 0, 0),
    (col.DAMPING_SHARE, "Damper alone: B/c", 1, 0),
    (col.STIFFNESS_SHARE_OF_BOTH, "Spring and damper: K/k", 0, 1),
    (col.DAMPING_SHARE_OF_BOTH, "Spring and damper: B/c", 1, 1),
)


def draw(result: StudyResult) -> list[tuple[str, str, Drawn]]:
    """Return the picture of the four ratios over frequency."""
    spectra, reach = result.table("spectra").columns, result.table("reach").columns
    hz = np.array(spectra[col.FREQUENCY_F])
    known = result.table("noticed").columns
    shares = zip(known[col.AT_BEST], known[col.AS_A_RULE], strict=True)
    noticed = dict(zip(known["quantity"], shares, strict=True))
    cases = list(dict.fromkeys(reach["case"]))
    motion = next(name for name in reach if name.startswith("worst error")).split()[-3]
    drawing, axes = figure(6.4, 2, 2, sharex=True, sharey=True)
    for name, title, i, j in _PLACES:
        place: Axes = axes[i, j]
        _noticed(place, noticed["stiffness" if name.startswith("K") else "damping"])
        for number, case in enumerate(cases):
            place.plot(hz, spectra[f"{case}: {name}"], color=JOINTS[number % len(JOINTS)], label=case,
                       linestyle=_DASHES[number % len(_DASHES)])  # fmt: skip
        place.axvline(float(motion), color="#666666", linewidth=0.8, linestyle=":")
        place.set_title(title)
        place.set_xscale("log")
        place.set_xlim(hz[0], hz[-1])
        place.set_ylim(0.0, 2.0)
    for j in (0, 1):
        axes[1, j].set_xlabel("frequency [Hz]")
    for i in (0, 1):
        axes[i, 0].set_ylabel("rendered / commanded")
    drawing.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8.5)
    caption = (
        f"{result.table('spectra').note} Shaded: not noticed at best (dark) and as a rule (pale) by a hand. "
        f"Dotted: the band of human motion, {motion} Hz."
    )
    return [("rendering", "Rendered over commanded", Drawn(drawing, caption))]


def _noticed(place: Axes, shares: tuple[float, float]) -> None:
    least, usual = (0.01 * share for share in shares)
    place.axhspan(1.0 - usual, 1.0 + usual, color=CONTACT, linewidth=0, zorder=0)
    place.axhspan(1.0 - least, 1.0 + least, color=WALL, linewidth=0, zorder=0)
