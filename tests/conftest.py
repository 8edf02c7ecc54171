"""What all tests share: pictures are drawn without a screen."""

import matplotlib

matplotlib.use("Agg")
