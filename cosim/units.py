"""Units of what a run records, by the names of signals and samples."""

__all__ = ["heading", "name_of", "sample_unit", "signal_unit"]

_SIGNALS = {
    "time": "s", "x": "m", "y": "m", "fx": "N", "fy": "N", "fmx": "N", "fmy": "N",
    "q": "rad", "v": "rad/s", "qm": "rad", "vm": "rad/s", "pot": "rad", "imot": "A", "tau_shaft": "N m",
    "u": "V", "ksp": "V", "ksd": "V", "cmd": "V",
}  # fmt: skip
_SAMPLES = {
    "time": "s", "pen": "m", "x": "m", "y": "m", "q_enc": "rad", "v_enc": "rad/s", "u_rad": "rad",
    "cmd_nm": "N m", "ksp": "N m/rad", "ksd": "N m s/rad",
}  # fmt: skip


def signal_unit(name: str) -> str:
    """Return the unit of a signal; a node of the board is a voltage."""
    if "." in name:
        return "V"
    plain = name.rstrip("0123456789")
    if plain.startswith(("p_", "e_")):
        return "W" if plain.startswith("p_") else "J"
    return _SIGNALS.get(plain, "")


def sample_unit(name: str) -> str:
    """Return the unit of a column of the computer's samples; gains and commands are at the joints."""
    return _SAMPLES.get(name.rstrip("0123456789"), "")


def heading(name: str, unit: str) -> str:
    """Return a column's heading: ``peak_force [N]``."""
    return f"{name} [{unit}]" if unit else name


def name_of(heading: str) -> str:
    """Return the name in a column's heading, with or without a unit."""
    return heading.partition(" [")[0]
