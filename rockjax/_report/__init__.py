"""Design report: checks of a problem file on one page, and the same tables as JSON, CSV and XLSX."""
