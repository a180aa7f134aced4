// Problems of ggbench in text files: arrays, h and its Jacobian H. C++17, no dependencies.
#pragma once
#include <algorithm>
#include <cmath>
#include <complex>
#include <fstream>
#include <iomanip>
#include <limits>
#include <map>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace ggbench {

using Number = std::complex<double>;  // derivatives by complex steps, exact to rounding
constexpr double STEP = 1e-20;

struct Array {
    std::vector<std::size_t> shape;
    std::vector<double> data;  // row-major order

    template <class... Index>
    const double& operator()(Index... index) const {
        std::size_t at = 0, axis = 0;
        ((at = at * shape[axis++] + static_cast<std::size_t>(index)), ...);
        return data[at];
    }
    template <class... Index>
    double& operator()(Index... index) {
        return const_cast<double&>(std::as_const(*this)(index...));
    }
};

inline Array zeros(std::vector<std::size_t> shape) {
    std::size_t size = 1;
    for (auto length : shape) size *= length;
    return {std::move(shape), std::vector<double>(size, 0.0)};
}

struct File {
    std::map<std::string, std::string> texts;
    std::map<std::string, Array> arrays;
    const Array& operator[](const std::string& name) const { return arrays.at(name); }
};

inline File read(const std::string& path) {
    std::ifstream in(path);
    if (!in) throw std::runtime_error("cannot read " + path);
    File file;
    std::string line, kind, name;
    while (std::getline(in, line)) {
        if (line.empty() || line[0] == '#') continue;
        std::istringstream head(line);
        head >> kind >> name;
        if (kind == "text") {
            std::getline(in, file.texts[name]);
            continue;
        }
        std::size_t axes;
        head >> axes;
        std::vector<std::size_t> shape(axes);
        for (auto& length : shape) head >> length;
        Array array = zeros(shape);
        std::string word;  // streams cannot read nan
        for (auto& number : array.data) {
            in >> word;
            number = std::strtod(word.c_str(), nullptr);
        }
        std::getline(in, line);
        file.arrays[name] = std::move(array);
    }
    return file;
}

inline void write(const std::string& path, const File& file) {
    std::ofstream out(path);
    out << std::setprecision(std::numeric_limits<double>::max_digits10);
    for (const auto& [name, text] : file.texts) out << "text " << name << "\n" << text << "\n";
    for (const auto& [name, array] : file.arrays) {
        out << "array " << name << " " << array.shape.size();
        for (auto length : array.shape) out << " " << length;
        for (std::size_t i = 0; i < array.data.size(); ++i)
            out << (i % array.shape.back() ? " " : "\n") << array.data[i];
        out << "\n";
    }
    if (!out.flush()) throw std::runtime_error("cannot write " + path);
}

struct Matrix3 {
    Number a[3][3] = {};
};

inline Matrix3 product(const Matrix3& x, const Matrix3& y, bool transposed = false) {
    Matrix3 out;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            for (int k = 0; k < 3; ++k)
                out.a[i][j] += x.a[i][k] * (transposed ? y.a[j][k] : y.a[k][j]);
    return out;
}

struct Place {
    Number latitude, longitude, height;
};

// Measurement equation of a problem.
class Model {
public:
    explicit Model(const File& file)
        : p(file), states(p["linear"].shape[3]), channels(p["linear"].shape[2]),
          gradients(p["combined"].shape[2]), instrument(p.texts.at("instrument")) {}

    // Compute h (m) and H (m x n, row-major) of run r and epoch k at the state x (n).
    void measurement(int r, int k, const std::vector<double>& x, std::vector<double>& h,
                     std::vector<double>& H) const {
        h.assign(channels, 0.0);
        H.assign(channels * states, 0.0);
        for (std::size_t c = 0; c < channels; ++c) {
            h[c] = p["offset"](r, k, c);
            for (std::size_t i = 0; i < states; ++i) {
                H[c * states + i] = p["linear"](r, k, c, i);
                h[c] += H[c * states + i] * x[i];
            }
        }
        const double gain = p["gain"](r, k);
        if (gradients > 0 && gain != 0.0) {
            const Array& B = p["displacement"];
            std::vector<Number> e(6, 0.0);
            for (int j = 0; j < 6; ++j)
                for (std::size_t i = 0; i < B.shape[3]; ++i) e[j] += B(r, k, j, i) * x[i];
            const auto t = reading(r, k, e);
            for (std::size_t c = 0; c < gradients; ++c) h[c] += gain * t[c].real();
            for (int j = 0; j < (instrument == "strapdown" ? 6 : 3); ++j) {
                auto moved = e;
                moved[j] += Number(0.0, STEP);
                const auto slope = reading(r, k, moved);
                for (std::size_t c = 0; c < gradients; ++c)
                    for (std::size_t i = 0; i < B.shape[3]; ++i)
                        H[c * states + i] += gain * slope[c].imag() / STEP * B(r, k, j, i);
            }
        }
        add_gravity(r, k, x, h, H);
    }

private:
    const File& p;
    std::size_t states, channels, gradients;
    std::string instrument;

    void add_gravity(int r, int k, const std::vector<double>& x, std::vector<double>& h,
                     std::vector<double>& H) const {
        const Array &W = p["weights"], &map = p["gravity_coefficients"];
        bool used = false;
        for (std::size_t c = 0; c < channels; ++c)
            for (int i = 0; i < 3; ++i) used = used || W(r, k, c, i) != 0.0;
        if (!used || map.data.empty()) return;
        const Array& at = p["ins_position"];
        for (int j = -1; j < 3; ++j) {  // -1: h; 0 to 2: column j of H
            std::vector<Number> e(x.begin(), x.begin() + 3);
            if (j >= 0) e[j] += Number(0.0, STEP);
            const auto place = displaced({at(r, k, 0), at(r, k, 1), at(r, k, 2)}, e);
            const auto g = spline(p["gravity_origin"], p["gravity_step"], map, place);
            for (std::size_t c = 0; c < channels; ++c)
                for (int i = 0; i < 3; ++i) {
                    if (j < 0) h[c] += W(r, k, c, i) * g[i].real();
                    else H[c * states + j] += W(r, k, c, i) * g[i].imag() / STEP;
                }
        }
    }

    // Sum of S T over the combined measurements; e: errors of position ENU [m] and attitude [rad].
    std::vector<Number> reading(int r, int k, const std::vector<Number>& e) const {
        std::vector<Number> t(gradients, 0.0);
        const Array &lags = p["lags"], &at = p["reading_positions"], &S = p["combined"];
        for (std::size_t i = 0; i < lags.shape[1]; ++i) {
            if (lags(k, i) < 0.0) continue;
            const int q = k - static_cast<int>(lags(k, i));
            const auto place = displaced({at(r, q, 0), at(r, q, 1), at(r, q, 2)}, e);
            Matrix3 M = normal_gradient(place.latitude, place.height);
            if (!p["map_coefficients"].data.empty()) {
                const auto v = spline(p["map_origin"], p["map_step"], p["map_coefficients"], place);
                const int of[3][3] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}};
                for (int a = 0; a < 3; ++a)
                    for (int b = 0; b < 3; ++b) M.a[a][b] += v[of[a][b]];
            }
            if (instrument != "local-level") {
                const Matrix3 C = mount(r, k, q, place, e);
                M = product(product(C, M), C, true);
            }
            const Number vec[6] = {M.a[0][0], M.a[0][1], M.a[0][2], M.a[1][1], M.a[1][2], M.a[2][2]};
            for (std::size_t c = 0; c < gradients; ++c)
                for (int j = 0; j < 6; ++j) t[c] += S(k, i, c, j) * vec[j];
        }
        return t;
    }

    Matrix3 mount(int r, int k, int q, const Place& at, const std::vector<Number>& e) const {
        if (instrument == "platform") {
            const Number L = at.latitude;
            const Number a = at.longitude + p["ellipsoid"](3) * p["reading_times"](q);
            return {{{-sin(a), -sin(L) * cos(a), cos(L) * cos(a)},
                     {cos(a), -sin(L) * sin(a), cos(L) * sin(a)},
                     {0.0, cos(L), sin(L)}}};
        }
        const Matrix3 turned = turn(e[3], e[4], e[5]);
        Matrix3 C, body;
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) C.a[i][j] = p["reading_attitudes"](r, k, i, j);
        C = product(turned, C);
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) body.a[i][j] = C.a[j][i];
        return body;
    }

    // Rotation matrix: exponential of the cross-product matrix of (x, y, z) (Rodrigues).
    static Matrix3 turn(Number x, Number y, Number z) {
        const Number square = x * x + y * y + z * z, angle = std::sqrt(square);
        Number a = 1.0, b = 0.5;
        if (std::abs(square) > 1e-12) {
            a = sin(angle) / angle;
            b = (1.0 - cos(angle)) / square;
        }
        const Matrix3 X{{{0.0, -z, y}, {z, 0.0, -x}, {-y, x, 0.0}}};
        Matrix3 out = product(X, X);
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j)
                out.a[i][j] = (i == j ? 1.0 : 0.0) + a * X.a[i][j] + b * out.a[i][j];
        return out;
    }

    // Position minus a position error ENU [m].
    Place displaced(const Place& at, const std::vector<Number>& e) const {
        const double a = p["ellipsoid"](0), e2 = p["ellipsoid"](1);
        const Number w2 = 1.0 - e2 * sin(at.latitude) * sin(at.latitude);
        const Number east = a / std::sqrt(w2), north = east * (1.0 - e2) / w2;
        return {at.latitude - e[1] / (north + at.height),
                at.longitude - e[0] / ((east + at.height) * cos(at.latitude)), at.height - e[2]};
    }

    // Cubic B-spline of all components; outside the map, the value at the border.
    static std::vector<Number> spline(const Array& origin, const Array& step, const Array& c,
                                      const Place& place) {
        const Number at[3] = {place.latitude, place.longitude, place.height};
        std::size_t first[3];
        Number w[3][4];
        for (int axis = 0; axis < 3; ++axis) {
            Number u = (at[axis] - origin(axis)) / step(axis);
            const double cells = static_cast<double>(c.shape[axis]) - 3.0;
            if (!(u.real() >= 0.0 && u.real() <= cells)) u = std::clamp(u.real(), 0.0, cells);
            const double cell = std::min(std::floor(u.real()), cells - 1.0);
            first[axis] = static_cast<std::size_t>(cell);
            const Number t = u - cell, s = 1.0 - t;
            w[axis][0] = s * s * s / 6.0;
            w[axis][1] = (4.0 + t * t * (3.0 * t - 6.0)) / 6.0;
            w[axis][2] = (4.0 + s * s * (3.0 * s - 6.0)) / 6.0;
            w[axis][3] = t * t * t / 6.0;
        }
        std::vector<Number> value(c.shape[3], 0.0);
        for (int i = 0; i < 4; ++i)
            for (int j = 0; j < 4; ++j)
                for (int k = 0; k < 4; ++k)
                    for (std::size_t v = 0; v < value.size(); ++v)
                        value[v] += w[0][i] * w[1][j] * w[2][k] *
                                    c(first[0] + i, first[1] + j, first[2] + k, v);
        return value;
    }

    // Gravitational gradient of the ellipsoid's zonal field in ENU [E].
    Matrix3 normal_gradient(Number L, Number height) const {
        const Array &ellipsoid = p["ellipsoid"], &zonals = p["zonals"];
        const double a = ellipsoid(0), e2 = ellipsoid(1), gm = ellipsoid(2);
        const Number N = a / std::sqrt(1.0 - e2 * sin(L) * sin(L));
        const Number x = (N + height) * cos(L), z = (N * (1.0 - e2) + height) * sin(L);
        const Number r = std::sqrt(x * x + z * z), s = z / r, c = x / r;
        const std::size_t degrees = 2 * zonals.data.size();
        std::vector<Number> P(degrees + 1), D(degrees + 1), E(degrees + 1);
        P[0] = 1.0; P[1] = s; D[1] = 1.0;
        Number v_r = -1.0, v_s = 0.0, v_rr = 2.0, v_rs = 0.0, v_ss = 0.0, ratio = 1.0;
        for (std::size_t n = 2; n <= degrees; ++n) {
            const double m = static_cast<double>(n);
            P[n] = ((2.0 * m - 1.0) * s * P[n - 1] - (m - 1.0) * P[n - 2]) / m;
            D[n] = D[n - 2] + (2.0 * m - 1.0) * P[n - 1];
            E[n] = E[n - 2] + (2.0 * m - 1.0) * D[n - 1];
            if (n % 2) continue;
            ratio *= a * a / (r * r);
            const Number f = zonals(n / 2 - 1) * ratio;
            v_r += f * (m + 1.0) * P[n];
            v_s -= f * D[n];
            v_rr -= f * (m + 1.0) * (m + 2.0) * P[n];
            v_rs += f * (m + 1.0) * D[n];
            v_ss -= f * E[n];
        }
        v_r *= gm / (r * r); v_s *= gm / r; v_rr *= gm / (r * r * r);
        v_rs *= gm / (r * r); v_ss *= gm / r;
        const Number ee = v_r / r - s * v_s / (r * r);
        const Number nn = v_r / r + (c * c * v_ss - s * v_s) / (r * r);
        const Number nu = c * (v_rs / r - v_s / (r * r));
        // Sine and cosine of geodetic minus geocentric latitude.
        const Number si = sin(L) * c - cos(L) * s, co = cos(L) * c + sin(L) * s;
        Matrix3 out;
        out.a[0][0] = 1e9 * ee;
        out.a[1][1] = 1e9 * (co * co * nn - 2.0 * co * si * nu + si * si * v_rr);
        out.a[1][2] = out.a[2][1] = 1e9 * (co * si * (nn - v_rr) + (co * co - si * si) * nu);
        out.a[2][2] = 1e9 * (si * si * nn + 2.0 * co * si * nu + co * co * v_rr);
        return out;
    }
};

}  // namespace ggbench
