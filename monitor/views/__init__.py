"""What a person looks at: the web page, the printed report, plots, and tables on a terminal."""
