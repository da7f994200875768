"""Modified nodal analysis of a flat deck, read from its text alone (Ho, Ruehli and Brennan 1975).

Knows R, C, L, V, I, E, G, F, H and B sources, diodes (``is`` and ``n`` of their model), subcircuits and
parameters; B sources are linearised by central differences, which are exact for products of two voltages.
Anything else is an error. (G + s C) x = b: poles are the finite eigenvalues of the pencil, without a fit or a
frequency.
"""

import math
import re
from dataclasses import dataclass, field

import numpy as np
import scipy.linalg

SCALE = {"t": 1e12, "g": 1e9, "meg": 1e6, "k": 1e3, "m": 1e-3, "u": 1e-6, "n": 1e-9, "p": 1e-12, "f": 1e-15}
NUMBER = re.compile(r"(?<![\w.])(\d+\.?\d*|\.\d+)(e[-+]?\d+)?(meg|[tgkmunpf])?([a-z]*)", re.IGNORECASE)
FUNCTIONS = {name: getattr(math, name) for name in ("sqrt", "exp", "log", "tanh", "sin", "cos")} | {
    "abs": abs, "min": min, "max": max,
}  # fmt: skip


def _python(text):
    """A SPICE expression as Python: scale letters, ``^``, ``&&`` and ``a ? b : c``."""
    text = text.strip().lower().replace("^", "**").replace("&&", " and ").replace("||", " or ")
    depth = 0
    for at, c in enumerate(text):
        depth += (c == "(") - (c == ")")
        if c == "?" and depth == 0:
            inner = 0
            for end in range(at + 1, len(text)):
                inner += (text[end] in "(?") - (text[end] in ")") - (text[end] == ":" and inner > 0)
                if text[end] == ":" and inner == 0:
                    then, other = _python(text[at + 1 : end]), _python(text[end + 1 :])
                    return f"(({then}) if ({_python(text[:at])}) else ({other}))"

    def plain(match):
        digits, power, scale, _ = match.groups()
        return repr(float(digits + (power or "")) * SCALE.get((scale or "").lower(), 1.0))

    return NUMBER.sub(plain, text)


class Scope:
    """Parameters by name, evaluated when asked for; an inner scope hides the outer."""

    def __init__(self, outer=None):
        self.outer, self.text, self.from_outside = outer, {}, {}

    def value(self, text):
        text = text.strip().strip("{}'\"")
        return float(eval(_python(text), {"__builtins__": {}}, self))

    def __getitem__(self, name):
        if name in self.text:
            return self.value(self.text[name])
        if name in self.from_outside:
            return self.outer.value(self.from_outside[name])
        if self.outer is not None:
            return self.outer[name]
        if name in FUNCTIONS:
            return FUNCTIONS[name]
        raise KeyError(name)


#: Thermal voltage at 27 degrees, and what ngspice puts across a junction (gmin).
THERMAL_V, GMIN_S = 1.380649e-23 * 300.15 / 1.602176634e-19, 1e-12


@dataclass
class Subckt:
    pins: list
    defaults: dict
    body: list = field(default_factory=list)


def _words(line):
    """Blanks outside braces split; ``a = b`` is one word."""
    line = re.sub(r"\s*=\s*", "=", line)
    return re.findall(r"(?:\{[^}]*\}|[^\s{])+", line)


def _pairs(words):
    return {k.lower(): v for k, v in (w.split("=", 1) for w in words if "=" in w)}


class Circuit:
    """A circuit whose unknowns are node voltages and the currents of V, E, H and L."""

    def __init__(self, deck):
        rows = []
        for line in deck.split("\n")[1:]:
            if line.startswith("+"):
                rows[-1] += " " + line[1:]
            elif line.strip() and not line.startswith("*"):
                rows.append(line.strip())
        self.top, self.subckts, self.models, stack, main = Scope(), {}, {}, [], []
        for row in rows:
            words, key = _words(row), row.split()[0].lower()
            if key == ".subckt":
                assert not stack, "nested definitions are not for this reference"
                names = [w.lower() for w in words[2:] if "=" not in w and w.lower() != "params:"]
                stack.append(words[1].lower())
                self.subckts[stack[-1]] = Subckt(names, _pairs(words[2:]))
            elif key == ".ends":
                stack.pop()
            elif stack:
                self.subckts[stack[-1]].body.append(row)
            elif key == ".param":
                self.top.text |= _pairs(words[1:])
            elif key == ".model":
                inside = row.split(None, 2)[2].replace("(", " ").replace(")", " ")
                self.models[words[1].lower()] = _pairs(_words(inside))
            elif not key.startswith("."):
                main.append(row)
        self.index, self.elements, self.branches = {}, [], {}
        self._flatten(main, "", {}, self.top)
        self.names = list(self.index)
        self.size = len(self.index) + len(self.branches)

    def _node(self, name, path, nets):
        name = name.lower()
        full = "0" if name in ("0", "gnd") else nets.get(name, f"{path}.{name}" if path else name)
        if full != "0":
            self.index.setdefault(full, len(self.index))
        return full

    def _flatten(self, body, path, nets, scope):
        for row in body:
            if row.lower().startswith(".param"):
                scope.text |= _pairs(_words(row)[1:])
        for row in body:
            words = _words(row)
            name, kind = words[0].lower(), words[0][0].lower()
            full = f"{path}.{name}" if path else name
            if kind == ".":
                assert name in (".param", ".model"), row
            elif kind == "x":
                plain = [w for w in words[1:] if "=" not in w and w.lower() != "params:"]
                sub = self.subckts[plain[-1].lower()]
                nodes = [self._node(n, path, nets) for n in plain[:-1]]
                inner = Scope(scope)
                given = _pairs(words[1:])
                inner.from_outside = {k: v for k, v in given.items()}
                inner.text = {k: v for k, v in sub.defaults.items() if k not in given}
                self._flatten(sub.body, full, dict(zip(sub.pins, nodes, strict=True)), inner)
            else:
                self._element(full, kind, words, row, path, nets, scope)

    def _element(self, full, kind, words, row, path, nets, scope):
        def at(k):
            return self._node(words[k], path, nets)

        if kind in "rclvi":
            value = [w for w in words[3:] if "=" not in w and w.lower() not in ("dc",)]
            entry = (kind, full, (at(1), at(2)), scope.value(value[0]) if value else 0.0)
        elif kind in "eg":
            entry = (kind, full, (at(1), at(2), at(3), at(4)), scope.value(words[5]))
        elif kind in "fh":
            control = (f"{path}.{words[3].lower()}" if path else words[3].lower()) + "#"
            entry = (kind, full, (at(1), at(2)), (control, scope.value(words[4])))
        elif kind == "d":
            model = self.models[words[3].lower()]
            entry = (kind, full, (at(1), at(2)), tuple(scope.value(model.get(k, "1")) for k in ("is", "n")))
        elif kind == "b":
            what, text = re.split(r"\s*=\s*", row.split(None, 3)[3], maxsplit=1)
            seen = []

            def voltage(match):
                first = self._node(match[1], path, nets)
                second = self._node(match[2], path, nets) if match[2] else "0"
                seen.append((first, second))
                return f"__{len(seen) - 1}__"

            text = re.sub(r"\bv\(\s*([^\s,()]+)\s*(?:,\s*([^\s,()]+)\s*)?\)", voltage, text.lower())
            text = re.sub(r"__(\d+)__", r"x_[\1]", _python(re.sub(r"__(\d+)__", r"q\1q", text)))
            text = re.sub(r"q(\d+)q", r"x_[\1]", text)
            code = compile(text, full, "eval")
            entry = ("b" + what.lower(), full, (at(1), at(2)), (code, seen, scope))
        else:
            raise NotImplementedError(row)
        if kind in "vehl" or entry[0] == "bv":
            self.branches[f"{full}#"] = len(self.branches)
        self.elements.append(entry)

    def matrices(self, x):
        """G, C and b of the circuit linearised at `x`: G dx + C dx/dt = b, with what stands at rest in b."""
        n, size = len(self.index), self.size
        g, c, b = np.zeros((size, size)), np.zeros((size, size)), np.zeros(size)

        def put(m, i, j, value):
            if i != "0" and j != "0":
                m[row(i), row(j)] += value

        def row(name):
            return self.index[name] if name in self.index else n + self.branches[name]

        for kind, name, nodes, value in self.elements:
            p, m = nodes[:2]
            if kind in "rc":
                to, y = (g, 1.0 / value) if kind == "r" else (c, value)
                for i, j, sign in ((p, p, 1), (m, m, 1), (p, m, -1), (m, p, -1)):
                    put(to, i, j, sign * y)
            elif kind == "i":
                for i, sign in ((p, -1), (m, 1)):
                    if i != "0":
                        b[row(i)] += sign * value
            elif kind == "g":
                for i, si in ((p, 1), (m, -1)):
                    for j, sj in ((nodes[2], 1), (nodes[3], -1)):
                        put(g, i, j, si * sj * value)
            elif kind == "f":
                for i, si in ((p, 1), (m, -1)):
                    put(g, i, value[0], si * value[1])
            elif kind in ("bi", "d"):
                now, slopes = self._bent(value, x) if kind == "bi" else self._junction(value, nodes, x)
                rest = now
                for (first, second), slope in slopes:
                    for j, sj in ((first, 1), (second, -1)):
                        if j != "0":
                            rest -= sj * slope * x[row(j)]
                        for i, si in ((p, 1), (m, -1)):
                            put(g, i, j, si * sj * slope)
                for i, sign in ((p, -1), (m, 1)):
                    if i != "0":
                        b[row(i)] += sign * rest
            else:  # a branch with a current of its own, which ngspice calls by the element and a cross
                name = f"{name}#"
                for i, si in ((p, 1), (m, -1)):
                    put(g, i, name, si)
                    put(g, name, i, si)
                if kind == "v":
                    b[row(name)] += value
                elif kind == "l":
                    c[row(name), row(name)] -= value
                elif kind == "e":
                    for j, sj in ((nodes[2], 1), (nodes[3], -1)):
                        put(g, name, j, -sj * value)
                elif kind == "h":
                    put(g, name, value[0], -value[1])
                else:
                    now, slopes = self._bent(value, x)
                    rest = now
                    for (first, second), slope in slopes:
                        for j, sj in ((first, 1), (second, -1)):
                            if j != "0":
                                rest -= sj * slope * x[row(j)]
                            put(g, name, j, -sj * slope)
                    b[row(name)] += rest
        return g, c, b

    def _junction(self, value, nodes, x):
        """Current of a diode and its slope."""
        saturation, ideality = value
        scale = ideality * THERMAL_V
        volts = self.volts(x, nodes[0]) - self.volts(x, nodes[1])
        grown = saturation * math.exp(min(volts / scale, 300.0))
        return grown - saturation + GMIN_S * volts, [(nodes, grown / scale + GMIN_S)]

    def _bent(self, value, x):
        code, seen, scope = value

        def volts(pair):
            return sum(
                sign * (x[self.index[node]] if node != "0" else 0.0)
                for node, sign in zip(pair, (1, -1), strict=True)
            )

        v = [volts(pair) for pair in seen]

        def at(values):
            class Names(dict):
                def __missing__(self, name):
                    return scope[name]

            return float(eval(code, {"__builtins__": {}}, Names(x_=values)))

        slopes = []
        for k, pair in enumerate(seen):
            h = 1e-3
            up, down = list(v), list(v)
            up[k] += h
            down[k] -= h
            slopes.append((pair, (at(up) - at(down)) / (2 * h)))
        return at(v), slopes

    def operating_point(self):
        """Unknowns at rest by Newton's method from zero."""
        x = np.zeros(self.size)
        for _ in range(50):
            g, _, b = self.matrices(x)
            new = _solve(g, b)
            if np.abs(new - x).max() <= 1e-12 * max(1.0, np.abs(new).max()):
                return new
            x = new
        raise ArithmeticError("no operating point")

    def volts(self, x, node):
        return x[self.index[node]] if node != "0" else 0.0

    def response(self, source, hz, node):
        """What 1 V (or 1 A) of a source makes of a node at a frequency."""
        x = self.operating_point()
        g, c, _ = self.matrices(x)
        b = np.zeros(self.size)
        kind, name, nodes, _ = next(e for e in self.elements if e[1] == source)
        if kind == "v":
            b[len(self.index) + self.branches[f"{name}#"]] = 1.0
        else:
            for i, sign in zip(nodes, (-1, 1), strict=True):
                if i != "0":
                    b[self.index[i]] += sign
        return self.volts(_solve(g + 2j * np.pi * hz * c, b), node)

    def poles(self):
        """Finite eigenvalues [rad/s] of the circuit at rest.

        About a shift s0 they are s0 - 1/mu, mu the eigenvalues of (G + s0 C)^-1 C: sharp near the shift, so
        each decade of magnitude is read with a shift of its own.
        """
        g, c, _ = self.matrices(self.operating_point())
        held = np.flatnonzero(c.any(axis=0))  # the other columns of (G + s0 C)^-1 C are zero
        rows = []
        for decade in range(-4, 13):
            shift = 10.0**decade
            mu = scipy.linalg.eigvals(_solve(g + shift * c, c[:, held])[held])
            mu = mu[np.abs(mu) > 1e-13 * np.abs(mu).max(initial=0.0)]
            s = shift - 1.0 / mu
            low, high = 10.0 ** (decade - 0.5), 10.0 ** (decade + 0.5)
            rows.append(s[(np.abs(s) >= low) & (np.abs(s) < high)])
        return np.concatenate(rows)


def _solve(a, b):
    """Solve with rows and columns brought to one scale first."""
    r = 1.0 / np.abs(a).max(axis=1)
    scaled = a * r[:, None]
    k = 1.0 / np.abs(scaled).max(axis=0)
    right = (b.T * r).T
    return (np.linalg.solve(scaled * k, right).T * k).T
