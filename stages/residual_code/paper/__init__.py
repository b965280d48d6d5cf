"""One frame of the paper profile <-> its payload, with any of the nine lossless coders and our own."""
