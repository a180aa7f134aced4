// Extended Kalman filter: ekf PROBLEM.txt ESTIMATES.txt
#include <exception>
#include <iostream>

#include "ggbench.hpp"

using Vector = std::vector<double>;

// Multiply rows by the inverse of L in R = L L'. Scalar updates are then independent.
static void whiten(const Vector& root, std::size_t m, std::size_t columns, Vector& rows) {
    for (std::size_t c = 0; c < m; ++c)
        for (std::size_t j = 0; j < columns; ++j) {
            for (std::size_t b = 0; b < c; ++b)
                rows[c * columns + j] -= root[c * m + b] * rows[b * columns + j];
            rows[c * columns + j] /= root[c * m + c];
        }
}

static Vector cholesky(Vector a, std::size_t m) {
    for (std::size_t i = 0; i < m; ++i)
        for (std::size_t j = 0; j <= i; ++j) {
            double total = a[i * m + j];
            for (std::size_t k = 0; k < j; ++k) total -= a[i * m + k] * a[j * m + k];
            a[i * m + j] = i == j ? std::sqrt(total) : total / a[j * m + j];
        }
    return a;
}

int main(int count, char** words) try {
    if (count != 3) throw std::runtime_error("usage: ekf PROBLEM.txt ESTIMATES.txt");
    const ggbench::File p = ggbench::read(words[1]);
    const ggbench::Model model(p);
    const auto& z = p["measurements"];
    const std::size_t R = z.shape[0], K = z.shape[1], m = z.shape[2];
    const std::size_t n = p["prior_mean"].shape[0];
    ggbench::Array means = ggbench::zeros({R, K, n}), covs = ggbench::zeros({R, K, n, n});
    Vector h, H;
    for (std::size_t r = 0; r < R; ++r) {
        Vector x = p["prior_mean"].data, P = p["prior_cov"].data;
        for (std::size_t k = 0; k < K; ++k) {
            const double* F = &p["transition"](r, k, 0, 0);
            const double* Q = &p["process_cov"](r, k, 0, 0);
            Vector moved(n, 0.0), half(n * n, 0.0), next(Q, Q + n * n);
            for (std::size_t i = 0; i < n; ++i)
                for (std::size_t j = 0; j < n; ++j) {
                    moved[i] += F[i * n + j] * x[j];
                    for (std::size_t l = 0; l < n; ++l)
                        half[i * n + j] += F[i * n + l] * P[l * n + j];
                }
            for (std::size_t i = 0; i < n; ++i)
                for (std::size_t j = 0; j < n; ++j)
                    for (std::size_t l = 0; l < n; ++l)
                        next[i * n + j] += half[i * n + l] * F[j * n + l];
            x = moved;
            P = next;

            std::vector<std::size_t> there;
            for (std::size_t c = 0; c < m; ++c)
                if (p["present"](r, k, c) != 0.0) there.push_back(c);
            const std::size_t read = there.size();
            if (read) {
                model.measurement(static_cast<int>(r), static_cast<int>(k), x, h, H);
                Vector rows(read * n), left(read), noise(read * read);
                for (std::size_t c = 0; c < read; ++c) {
                    left[c] = z(r, k, there[c]) - h[there[c]];
                    for (std::size_t j = 0; j < n; ++j) rows[c * n + j] = H[there[c] * n + j];
                    for (std::size_t b = 0; b < read; ++b)
                        noise[c * read + b] = p["noise_cov"](k, there[c], there[b]);
                }
                const Vector root = cholesky(noise, read);
                whiten(root, read, n, rows);
                whiten(root, read, 1, left);
                const Vector before = x;
                for (std::size_t c = 0; c < read; ++c) {
                    const double* row = &rows[c * n];
                    Vector ph(n, 0.0);
                    double s = 1.0, innovation = left[c];
                    for (std::size_t i = 0; i < n; ++i) {
                        for (std::size_t j = 0; j < n; ++j) ph[i] += P[i * n + j] * row[j];
                        s += row[i] * ph[i];
                        innovation -= row[i] * (x[i] - before[i]);
                    }
                    for (std::size_t i = 0; i < n; ++i) {
                        x[i] += ph[i] / s * innovation;
                        for (std::size_t j = 0; j < n; ++j) P[i * n + j] -= ph[i] * ph[j] / s;
                    }
                }
            }
            for (std::size_t i = 0; i < n; ++i) {
                means(r, k, i) = x[i];
                for (std::size_t j = 0; j < n; ++j)
                    covs(r, k, i, j) = 0.5 * (P[i * n + j] + P[j * n + i]);
            }
        }
    }
    ggbench::File out;
    out.texts = {{"problem", p.texts.at("problem")}, {"causality", "filter"},
                 {"estimator", "cpp-ekf"}};
    out.arrays = {{"times", p["times"]}, {"mean", means}, {"cov", covs}};
    ggbench::write(words[2], out);
} catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 1;
}
