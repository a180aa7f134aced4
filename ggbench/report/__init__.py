"""Reports of campaigns and recorded flights: pages, tables and figures."""
