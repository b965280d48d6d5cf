"""Points on whole angles: sensors whose rays are none of a few fixed ones."""
