"""What lies on disk: folders that appear whole, check sums, and the form of what is read back."""
