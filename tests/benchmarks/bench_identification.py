"""What each model makes of the same second moments, against the truth.

Run ``python tests/benchmarks/bench_identification.py [--write]``. Section 5.1 of the
paper in small: ten relevant and ten irrelevant inputs at a signal-to-noise ratio of 2;
medians over ten trials, at two numbers of samples: what does not get better with more
of them is not identified.
"""

import numpy as np
from _report import fixed, parser, publish, rst_table

from sklearn_vbjfa import VBJFARegressor
from sklearn_vbjfa.datasets import make_noisy_regression

SAMPLES = (500, 50_000)
HEADERS = [
    "samples",
    "model",
    "input noise / true",
    "output noise / true",
    "coef. error",
    "query error",
    "relevant kept",
    "irrelevant kept",
]


def models(data):
    """Return name -> estimator; what is known of the noise comes from the data."""
    covariance = data.input_noise_covariance
    return {
        "paper": VBJFARegressor(latent="independent", prior="paper", query="noiseless"),
        "default": VBJFARegressor(query="noiseless"),
        "known variances": VBJFARegressor(
            latent="correlated",
            input_noise=np.diagonal(covariance).copy(),
            query="noiseless",
        ),
        "known covariance": VBJFARegressor(
            latent="correlated", input_noise=covariance, query="noiseless"
        ),
    }


def figures(model, data):
    """Return the figures of a fitted model, in the order of the headers."""
    noise = model.input_noise_
    noise = noise if noise.ndim == 1 else np.diagonal(noise)
    which = data.relevant
    error = model.predict(data.X_test) - data.y_test
    return [
        np.median(noise[which] / data.input_noise[which]),
        model.output_noise_ / data.output_noise,
        np.linalg.norm(model.coef_[which] - data.coef) / np.linalg.norm(data.coef),
        np.mean(error**2) / data.y_test.var(),
        model.relevant_[which].sum(),
        model.relevant_[data.irrelevant].sum(),
    ]


def run(n_samples, n_trials=10):
    """Return name -> figures (n_trials, 6)."""
    found = {}
    for seed in range(n_trials):
        data = make_noisy_regression(n_samples, n_irrelevant=10, random_state=seed)
        for name, model in models(data).items():
            found.setdefault(name, []).append(figures(model.fit(data.X, data.y), data))
    return {name: np.array(values) for name, values in found.items()}


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0]).parse_args(argv)
    rows = []
    for n_samples in SAMPLES:
        for name, values in run(n_samples).items():
            median, mean = np.median(values, axis=0), values.mean(axis=0)
            rows.append(
                [
                    str(n_samples),
                    name,
                    *fixed(median[:2], 2),
                    *fixed(median[2:4], 4),
                    *fixed(mean[4:]),
                ]
            )
    publish(
        "identification",
        rst_table(rows, HEADERS, n_labels=2),
        write=arguments.write,
    )


if __name__ == "__main__":
    main()
