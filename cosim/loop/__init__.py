"""The time loop: ticks, computer, noise, lockstep, energy ledger."""
