"""Many runs of one scene, side by side."""
