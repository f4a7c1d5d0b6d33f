"""What a person looks at: web page, printed report, plots, terminal. I/O."""
