"""``cosim device``: the four numbers of a device - force, stiffness, damping, workspace."""

import argparse
from pathlib import Path
from typing import Any

from cosim.caution import collected
from cosim.commands.command import Command, about, load_variants, scene_arguments
from cosim.units import name_of, quantity, unit_in


def _arguments(parser: argparse.ArgumentParser) -> None:
    scene_arguments(parser)
    parser.add_argument("-o", "--out", dest="file", metavar="FILE", help="write the numbers as CSV")


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.ngspice.child import on_demand

    with on_demand() as child:
        from cosim.api.queries import device
        from cosim.storage.owned_files import own_file
        from cosim.studies.device import PRESETS, flat

        if args.file:
            own_file(args.file)
        cases, texts, columns = [], [], {}
        every = load_variants(args)
        for variant, scene in every:
            with collected(about(variant, every)):
                numbers = device(scene, trust=args.trust, child=child)
                cases.append({"set": dict(variant.values), **numbers.as_dict()})
                head = variant.label or scene.title
                columns[head] = flat(numbers)
                lines = [f"{head} (circuit model {numbers.model}, {quantity(numbers.period_s, 's')})"]
                lines += [
                    f"  {name_of(name):38s}{_text(value, unit_in(name))}"
                    for name, value in columns[head].items()
                ]
                texts.append("\n".join([*lines, f"  workspace: {numbers.workspace.note}"]))
    if args.file:
        _write(Path(args.file), columns)
        texts.append(f"wrote {args.file}")
    known = "; ".join(
        f"{p.name} {quantity(p.force_n, 'N', 4)}, {quantity(p.stiffness_n_per_m, 'N/m', 4)}, "
        f"{quantity(p.damping_n_s_per_m, 'N s/m', 4)}"
        for p in PRESETS
    )
    texts.append(f"for comparison, limits recommended for controllers (CHAI3D): {known}")
    published = [vars(preset) for preset in PRESETS]
    return {"cases": cases, "published": published}, "\n".join(texts)


def _text(value: Any, unit: str) -> str:
    if value is None:
        return "-"
    return quantity(value, unit, 4) if isinstance(value, float) else str(value)


def _write(file: Path, columns: dict[str, dict[str, Any]]) -> None:
    """Write one row a number, one column a case."""
    import csv
    import io

    from cosim.storage.owned_files import write_file

    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(["number", *columns])
    for name in next(iter(columns.values())):
        writer.writerow([name.strip(), *(case[name] for case in columns.values())])
    write_file(file, table.getvalue().encode())


COMMAND = Command("device", "tell force, stiffness, damping and workspace of the device", _arguments, _run)
