"""Pages and tables: one trial, and materials compared."""
