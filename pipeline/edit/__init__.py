"""Archives made of archives: cut, merged, redacted, recovered."""
