"""Pictures that commands draw with `--plot`, each written as a PNG or as one self-contained HTML file. I/O."""
