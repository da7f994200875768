"""Questions that need several runs: what an effect changes and costs, what an edit did."""
