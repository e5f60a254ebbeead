"""Choice of smoothness factors and time shifts before the search."""
