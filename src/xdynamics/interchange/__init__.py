"""Records for others: xarray's accessor and backend, CSV."""
