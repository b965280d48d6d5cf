"""Prediction of the paper profile: the frames before, moved and extrapolated (ST-LSTM), and neighbours in the grid."""
