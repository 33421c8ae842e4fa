"""The design report: the results of the checks in a problem file, as a page and as JSON, CSV and XLSX."""
