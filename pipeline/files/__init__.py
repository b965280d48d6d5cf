"""Archives as the files that their scans came from: a tree, a file system of fsspec, a mounted folder."""
