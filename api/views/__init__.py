"""What a person is shown of a dataset, as bodies of answers: pure functions from a dataset and its fits."""
