"""Reference pages of the site, written from the program itself whenever the site is built.

A key, an effect, a measure, a command or a hard case that is added to the program is on its page at the
next build; nothing of it is written twice.
"""

import argparse
import html
import inspect
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
#: A signature that is longer stands on several lines.
_LINE = 70
#: How much pages that name everything count in the search, against 1 of a page that explains.
_LOUD = {
    "python": 0.3,
    "changelog": 0.1,
    "contributing": 0.2,
    "security": 0.3,
    "measures": 0.2,
    "hard-cases": 0.5,
}


def on_files(files: Files, config: Any) -> Files:
    """Add the generated pages, and the pictures that the repository publishes."""
    for name, written in PAGES.items():
        head = f"---\nsearch:\n  boost: {_LOUD[name]}\n---\n\n" if name in _LOUD else ""
        files.append(File.generated(config, f"reference/{name}.md", content=head + written()))
    for picture in sorted((ROOT / "reports/gallery").glob("*.png")):
        files.append(File(f"gallery/{picture.name}", str(ROOT / "reports"), config.site_dir, False))
    return files


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown; a bar within a cell stays one cell."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def code(text: str) -> str:
    """Return text as code, nothing as nothing."""
    if "|" in text:  # which ends a cell, and in back-ticks cannot be written otherwise
        return f"<code>{html.escape(text).replace('|', '&#124;')}</code>"
    return f"`{text}`" if text else ""


def scene() -> str:
    """Write the keys of a scene, a table for each section."""
    from cosim.effects import EFFECTS
    from cosim.scene.keys import keys

    through = {key: effect.name for effect in EFFECTS for key in effect.keys}
    sections: dict[str, list[Any]] = {}
    for key in keys():
        sections.setdefault(key.path.rpartition(".")[0], []).append(key)
    text = [
        "# Scene keys",
        "",
        "A scene is a TOML file. Every key is listed with its unit, its range and its default; "
        "`cosim keys WORD` prints a section, a key, or all whose name or meaning has the word. "
        "A number has the unit at the end of its name (`period_s`, "
        "`stiffness_n_per_m`). What a scene does not state has its default; a key that acts through an "
        "effect is idle while that is off. Names in angle brackets are yours.",
        "",
    ]
    for name, keys_of in sections.items():
        anchor = re.sub(r"[<>.]+", "-", name).strip("-") or "top"
        text += [f"## {_prose(f'[{name}]') if name else 'Top level'} {{ #{anchor} }}", ""]
        rows = [
            [
                code(key.path.removeprefix(f"{name}.")), key.unit,
                f"{key.kind}: {key.allowed}" if key.allowed else key.kind,
                "**required**" if key.default == "required" else code(key.default),
                key.meaning + (f"; through `effects.{through[key.path]}`" if key.path in through else ""),
            ]
            for key in keys_of
        ]  # fmt: skip
        text += [table(["key", "unit", "what is written", "default", "meaning"], rows), ""]
    return "\n".join(text)


def effects() -> str:
    """Write what a scene may switch on."""
    from cosim.effects import EFFECTS
    from cosim.scene.meanings import MEANINGS

    text = [
        "# Effects",
        "",
        "An effect is asked for in `[effects]`, or it is not there: no node, no state, no breakpoint, no "
        "random number. The effects in force choose the [circuit model](../explanation/three-models.md). "
        "`cosim plan SCENE` tells how large each is in your scene before anything runs.",
        "",
    ]
    homes: dict[str, list[Any]] = {}
    for effect in EFFECTS:
        homes.setdefault(effect.home, []).append(effect)
    for home, effects_of in homes.items():
        rows = []
        for effect in effects_of:
            values = ", ".join(code(_toml(value)) for value in effect.on)
            levels = effect.at_full if "full" in effect.on and effect.at_full != effect.models else None
            carried = _models(effect.models) + (f"; `full`: {_models(levels)}" if levels else "")
            needs = [f"needs `{name}`" for name in effect.requires]
            needs += [f"not with `{name}`" for name in effect.excludes]
            rows.append([
                code(effect.name), values, code(_toml(effect.null)),
                MEANINGS[f"effects.{effect.name}"] + (f" ({', '.join(needs)})" if needs else ""), carried,
            ])  # fmt: skip
        text += [
            f"## Of the {home}",
            "",
            table(["effect", "values", "null form", "what it is", "carried by"], rows),
            "",
        ]
    return "\n".join(text)


def _models(names: Iterable[str]) -> str:
    return ", ".join(name for name in ("ideal", "linear", "spice") if name in names)


def _toml(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(getattr(value, "value", value))


def measures() -> str:
    """Write the catalogue of measures, by what they need."""
    from cosim.catalogue import ETA_OF, MEASURES, Need

    text = [
        "# Measures",
        "",
        "Names for `[measures] names`, `--measure`, `--spec` and the `[tolerance]` table. Those that need no "
        "run cost none. Your own is a Python class: [Add a measure](../how-to/own-measure.md).",
        "",
    ]
    for need in Need:
        rows = [[code(m.name), m.unit or "1", m.text] for m in MEASURES.values() if m.needs is need]
        if need is Need.CONTACT:
            shown = "what a block takes of eta; `cosim nodes` lists the blocks"
            rows.append([code(f"{ETA_OF}BLOCK"), "1", shown])
        text += [f"## From {need.value}", "", table(["measure", "unit", "what it is"], rows), ""]
    return "\n".join(text)


def commands() -> str:
    """Write every command with its options, from the parser."""
    from cosim import cli

    parser = cli.build_parser()
    (subs,) = [a.choices for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    shared = {"--json", "--strict", "--quiet", "--verbose", "--help"}
    general = [action for action in subs["run"]._actions if shared & set(action.option_strings)]
    text = [
        "# Commands",
        "",
        "Exit codes: 0 on success, 1 when a simulation failed, 2 for a mistake in the input, 130 after "
        'Ctrl-C; finished results stay whole. `eval "$(cosim --completion bash)"` completes commands and '
        "options (also zsh and tcsh). `NO_COLOR` is obeyed.",
        "",
        "Every command takes",
        "",
        table(["option", "what it does"], [_option(action) for action in general]),
        "",
    ]
    for command in cli.commands():
        sub = subs[command.name]
        own = [action for action in sub._actions if not shared & set(action.option_strings)]
        text += [
            f"## cosim {command.name} {{ #{command.name} }}",
            "",
            f"{command.help[0].upper()}{command.help[1:]}.",
            "",
        ]
        text += [f"```text\n{_usage(sub)}\n```", ""]
        if own:
            text += [table(["argument", "what it is"], [_option(action) for action in own]), ""]
    return "\n".join(text)


def _usage(sub: argparse.ArgumentParser) -> str:
    formatter = argparse.HelpFormatter(sub.prog, width=84)
    formatter.add_usage(sub.usage, sub._actions, sub._mutually_exclusive_groups)
    return formatter.format_help().strip()


def _option(action: argparse.Action) -> list[str]:
    shown = (
        action.metavar if isinstance(action.metavar, str) else (action.metavar or [action.dest.upper()])[0]
    )
    if action.choices and not isinstance(action.metavar, str):
        shown = "{" + ",".join(map(str, action.choices)) + "}"
    if not action.option_strings:
        return [code(str(action.metavar or action.dest)), _help(action)]
    value = "" if action.nargs == 0 else f" {shown}"
    return [", ".join(code(f"{name}{value}") for name in action.option_strings), _help(action)]


def _help(action: argparse.Action) -> str:
    text = (action.help or "").replace("%%", "%")
    return re.sub(r"<(\w+)>", r"`<\1>`", text)


def netlists() -> str:
    """Take over the page that travels with every project."""
    return _taken("netlists/README.md")


def _taken(name: str) -> str:
    """Return a page of the repository, its links to files of the repository as plain text."""
    text = (ROOT / name).read_text(encoding="utf-8")
    return re.sub(r"\[([^]]+)\]\((?!https?:)[^)]+\)", r"\1", text)


def python() -> str:
    """Write the names of `import cosim`, with signature and docstring."""
    import cosim

    text = [
        "# Python API",
        "",
        "`import cosim` gives what the commands do. Names load when they are first used; the package is "
        "typed. A doubt about a result is a Python warning (`cosim.caution.Doubt`), an error is one of the "
        "last four.",
        "",
    ]
    last = ["CosimError", "InputError", "SimulationError", "StorageError"]
    names = [name for name in cosim.__all__ if name != "errors" and name not in last]
    for name in [*sorted(names, key=str.lower), *last]:
        text += _object(name, getattr(cosim, name), 2)
    return "\n".join(text)


def _object(name: str, value: Any, level: int) -> list[str]:
    text = [f"{'#' * level} {name} {{ #{name} }}", ""]
    if callable(value) and not (inspect.isclass(value) and issubclass(value, Exception)):
        text += ["```python", f"{name.rpartition('.')[2]}{_signature(value)}", "```", ""]
    text += [docstring(inspect.getdoc(value) or ""), ""]
    if inspect.isclass(value) and level == 2:
        for member, method in list(vars(value).items()):  # a table of a scene is built when it is first used
            plain = getattr(method, "__func__", method)
            if not member.startswith(("_", "model_")) and inspect.isfunction(plain) and plain.__doc__:
                text += _object(f"{name}.{member}", plain, 3)
            elif not member.startswith("_") and isinstance(method, property) and method.__doc__:
                text += [
                    f"### {name}.{member} {{ #{name}.{member} }}",
                    "",
                    docstring(inspect.getdoc(method) or ""),
                    "",
                ]
    return text


def _signature(value: Any) -> str:
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):
        return "(...)"
    text = _short(str(signature))
    if len(text) < _LINE:
        return text
    lines, keyword = [], False
    for each in signature.parameters.values():
        if each.kind is each.KEYWORD_ONLY and not keyword:
            keyword = True
            lines.append("*")
        lines.append(_short(str(each)))
    gives = signature.return_annotation
    gives = gives.__name__ if inspect.isclass(gives) else _short(str(gives))
    back = "" if signature.return_annotation is signature.empty else f" -> {gives}"
    return "(\n" + "".join(f"    {line},\n" for line in lines) + f"){back}"


def _short(text: str) -> str:
    """Return annotations without modules, and without quotes of their own; defaults keep theirs."""
    text = re.sub(r"(: |-> )'([^']*)'", r"\1\2", text)
    return re.sub(r"\b(?:[a-z_]\w*\.)+([A-Z]\w*)", r"\1", text)


_HEAD = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)


def docstring(text: str) -> str:
    """Return a docstring in the style of numpy as Markdown."""
    text = text.replace("``", "`")
    head, *parts = _HEAD.split(text)
    out = [_prose(head)]
    for title, body in zip(parts[::2], parts[1::2], strict=True):
        out += ["", f"**{title}**", ""]
        if title == "Examples":
            out.append(_examples(body.strip("\n")))
        else:
            out.append(_definitions(body.strip("\n")))
    return "\n".join(out)


def _prose(text: str) -> str:
    return re.sub(r"</?(\w+)>", r"&lt;\1&gt;", text)


def _definitions(body: str) -> str:
    """Return entries of a section as a list: the name, and what is indented behind it."""
    lines: list[str] = []
    for line in body.split("\n"):
        if line.startswith(" ") and lines:
            lines[-1] += " " + line.strip()
        elif line.strip():
            name, colon, rest = line.partition(" : ")
            lines.append(f"- `{name}`: {rest}" if colon else f"- `{line.strip()}`:")
    return _prose("\n".join(lines))


def _examples(body: str) -> str:
    """Return examples: prose between, prompts and what they print as code."""
    out: list[str] = []
    for block in re.split(r"\n\s*\n", body):
        prose, prompt, rest = block.partition(">>> ")
        if prose.strip():
            out += [_prose(prose.strip()), ""]
        if prompt:
            out += ["```pycon", prompt + rest, "```", ""]
    return "\n".join(out)


def hard_cases() -> str:
    """Write the scenes whose answer theory knows."""
    from cosim.accuracy.hard_cases.case_table import CASES

    rows = [
        [
            str(case.row), case.name + (" (slow)" if case.slow else ""), case.what, f"{case.expected:.6g}",
            "<br>".join(f"{model}: {bound:.2g}" for model, bound in case.bound.items()), case.reason,
        ]
        for case in CASES
    ]  # fmt: skip
    text = [
        "# Hard cases",
        "",
        "Scenes whose answer theory knows, on every circuit model that can run them. The bound is the "
        "largest difference from that answer which counts as right, in the unit of what is found; its reason "
        "stands beside it. Run them with `cosim hard-cases` (all: `--slow`); the command exits with 1 when "
        "one is missed.",
        "",
        table(["#", "case", "what is found", "expected", "bound", "reason of the bound"], rows),
        "",
    ]
    return "\n".join(text)


PAGES: dict[str, Callable[[], str]] = {
    "scene": scene,
    "effects": effects,
    "measures": measures,
    "commands": commands,
    "netlists": netlists,
    "python": python,
    "hard-cases": hard_cases,
    "changelog": lambda: _taken("CHANGELOG.md"),
    "security": lambda: _taken("SECURITY.md"),
    "contributing": lambda: _taken("CONTRIBUTING.md"),
}
