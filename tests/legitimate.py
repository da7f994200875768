"""Latches, Schmitt triggers and oscillators as people build them, each a block `extra in out vcc vee`.

`{said}` is where the block declares what it is. Values: around 1 kHz, or switching at some volts.
"""

BISTABLE = {
    "inverting Schmitt trigger": "R1 out p 10k\nR2 p 0 10k\nxop p in vcc vee out tl072",
    "non-inverting Schmitt trigger": "R1 in p 10k\nR2 p out 47k\nRm m 0 1k\nxop p m vcc vee out tl072",
    "little hysteresis": "R1 in p 1k\nR2 p out 1meg\nxop p 0 vcc vee out ua741",
    "Schmitt trigger with a capacitor": "R1 out p 10k\nR2 p 0 1k\nC1 p 0 1n\nxop p in vcc vee out opa2134",
    "latch of two amplifiers": (
        "R1 in a 10k\nR2 q2 a 10k\nR3 a 0 100k\nxa 0 a vcc vee out tl072\n"
        "R4 out b 10k\nR5 b 0 100k\nxb 0 b vcc vee q2 tl072"
    ),
    "cross-coupled transconductors": (
        "G1 out 0 q 0 2m\nG2 q 0 out 0 2m\nR1 out 0 1k\n"
        "R2 q 0 1k\nC1 out 0 1n\nC2 q 0 1n\nR3 in q 1meg"
    ),
    "flip-flop of ideal sources": (
        "E1 a 0 b 0 -3\nRa a out 1k\nCa out 0 1n\n"
        "E2 c 0 out 0 -3\nRc c b 1k\nCb b 0 1n\nR3 in out 1meg"
    ),
    "monostable": "C1 out p 10n\nR1 p 0 100k\nR2 out p 200k\nRi in p 1meg\nxop p 0 vcc vee out tl072",
    "comparator fed back behind its load": (
        "R0 out l 100\nC0 l 0 10n\n"
        "R1 l p 10k\nR2 p 0 2k\nxop p in vcc vee out tl072"
    ),
    "precision latch": "R1 in p 10k\nR2 p o 100k\nxop p 0 vcc vee o tl072\nxb o out vcc vee out tl072",
}  # fmt: skip
OSCILLATING = {
    "Wien bridge": (
        "R1 out a 10k\nC1 a p 10n\nR2 p 0 10k\nC2 p 0 10n\nR3 out m 22k\nR4 m 0 10k\nRi in m 10meg\n"
        "xop p m vcc vee out tl072"
    ),
    "astable multivibrator": (
        "R1 out m 10k\nC1 m 0 10n\nR2 out p 10k\nR3 p 0 10k\nRi in m 10meg\nxop p m vcc vee out tl072"
    ),
    "phase shift": (
        "C1 out a 10n\nR1 a 0 10k\nC2 a b 10n\nR2 b 0 10k\nC3 b c 10n\nR3 c m 10k\nR4 m out 400k\n"
        "Ri in m 10meg\nxop 0 m vcc vee out tl072"
    ),
    "triangle and square": (
        "R1 t p 10k\nR2 p out 20k\nxc p 0 vcc vee out tl072\nR3 out m 10k\nC3 m t 10n\nR4 m t 10meg\n"
        "Ri in m 10meg\nxi 0 m vcc vee t tl072"
    ),
    "quadrature": (
        "R1 out a 10k\nC1 a s 10n\nxa 0 a vcc vee s tl072\nR2 s b 10k\n"
        "C2 b 0 10n\nR3 b out 20k\nR4 f 0 10k\n"
        "R5 f out 10k\nRn out b 9k\nRi in a 10meg\nxb b f vcc vee out tl072"
    ),
    "negative resistance and a tank": (
        "L1 p 0 10m\nC1 p 0 1u\nR0 p 0 100k\nR1 p out 10k\nR2 out m 10k\nR3 m 0 10k\nRi in p 10meg\n"
        "xop p m vcc vee out tl072"
    ),
    "Colpitts with a transconductor": (
        "G1 c 0 e 0 -5m\nRl c 0 10k\nL1 c 0 1m\nC1 c e 10n\n"
        "C2 e 0 10n\nRe e 0 10k\nRo c out 1k\nRx out in 1meg"
    ),
    "ring of three": (
        "R1 in a 100k\nR2 c a 10k\nR7 a o1 40k\nC1 a o1 1n\nx1 0 a vcc vee o1 tl072\n"
        "R3 o1 b 10k\nR8 b o2 40k\nC2 b o2 1n\nx2 0 b vcc vee o2 tl072\n"
        "R4 o2 d 10k\nR9 d c 40k\nC3 d c 1n\nx3 0 d vcc vee c tl072\nR5 c out 1k"
    ),
    "gyrated resonator": (
        "G1 a 0 b 0 1m\nG2 b 0 a 0 -1m\nC1 a 0 100n\nC2 b 0 100n\n"
        "R1 a 0 100k\nG3 0 a a 0 200u\nR2 b 0 1meg\n"
        "Ri in a 10meg\nRo a out 1k"
    ),
    "crystal": (
        "Lx x1 x2 1\nCx x2 p 25f\nRx x1 out 500\nCp x1 p 5p\n"
        "Rb p 0 1meg\nR1 out m 10k\nR2 m 0 1k\nRi in m 10meg\n"
        "xop p m vcc vee out opa2134"
    ),
}  # fmt: skip


def board_with(text, name, body, declared):
    """Board of one joint with a block more, which declares itself or does not."""
    result = f"*@ stability={declared}\n" if declared else ""
    block = f"* {name}\n.subckt extra in out vcc vee\n{result}{body}\n.ends extra\n"
    return text.replace(".subckt board1", block + "\n.subckt board1").replace(
        ".ends board1", "xextra pot1 e1 vcc vee extra\nRextra e1 0 10k\n.ends board1"
    )
