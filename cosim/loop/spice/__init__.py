"""The loop in which ngspice owns time: linkage and computer in lockstep with it."""
