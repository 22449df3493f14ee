"""What Python, its processes and the file system need: late imports, forks, files."""
