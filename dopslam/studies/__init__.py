"""Many runs and what they say, with intervals."""
