"""Records for other programs: xarray's accessor and backend, CSV."""
