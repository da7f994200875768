"""What the page on the paper quotes, and where its studies find it."""

#: Study -> (what a verdict found, or a row of a short table, with a number, or two of which the page says by
#: how many per cent the second is less; what the page quotes; by how much it may differ; the page's words).
#: Bands: rounding of the quoted digits and, of shares of poses, a few poses.
QUOTED = {
    "0_1_acceptance": [
        (r"^([\d.]+) % at most \(as built", 0.004, 0.0005, "0.004 % on ideal parts"),
        (r"as built: ([\d.]+) %", 0.02, 0.005, "0.02 % as built"),
        (r"within 1 % in ([\d.]+) % of the workspace", 40.0, 1.0, "within 1 % in 40 % of the workspace"),
        (r"half way to the wall in ([\d.]+) %", 98.0, 1.0, "in 98 %"),
    ],
    "3_fig16_18": [(r"^([\d.]+); by the motors' stiffness", 0.569, 0.001, "ratio 0.569, expected 0.571")],
    "5_1_eta": [
        (r"^([\d.]+) % at 100 N/m", 4.0, 0.5, "Delay eats 4 % of the damping"),
        (r"^([\d.]+) N/m, off by", 2400.0, 50.0, "2.4 kN/m"),
        (
            r"^limits: current drive;.* practical limit b/sum \[N/m\] ([\d.]+)",
            250.0,
            5.0,
            "0.25 kN/m with current drive",
        ),
    ],
    "6a_ceiling": [
        (r"^([\d.]+) N/m \(potentiometer noise above 0\.05 N rms\)", 58.0, 0.5, "58 N/m"),
        (r"([\d.]+) N/m \(multiplier at full scale\)", 169.0, 0.5, "169 N/m"),
        (r"([\d.e+]+) N/m \(circuit delay: passive device\)", 3900.0, 50.0, "3.9 kN/m by delay"),
    ],
    "1_fig13": [
        (r"^slope (-[\d.]+); of the exact", -0.94, 0.005, "log-log slope -0.94"),
        (r"of the exact limit (-[\d.]+)$", -0.93, 0.005, "that of the exact limit -0.93"),
        (r"^-([\d.]+) % at 3 ms", 2.6, 0.05, "at most 2.6 % up to 10 ms"),
        (r"-([\d.]+) % at 52\.7 ms", 43.0, 0.5, "at 53 and 73 ms"),
        (r"-([\d.]+) % at 72\.6 ms", 53.0, 0.5, "43 and 53 % softer"),
        (
            r"\+([\d.]+) N/m with an ideal circuit; with its own differentiator \+([\d.]+) exact",
            18.0,
            0.5,
            "differentiator takes 18 % of the gain at 3 ms",
        ),
    ],
    "6b_onset": [
        (r"^rests up to .* ([\d.]+) at 25 ms", 400.0, 5.0, "on up to 400 N/m at 25 ms"),
        (r"^rests up to .* ([\d.]+) at 100 ms", 80.0, 1.0, "80 N/m at 100 ms"),
    ],
    "7_footnote2": [(r"^median ([\d.]+) %", 15.0, 0.5, "shifts by 15 % in the median pose")],
}
