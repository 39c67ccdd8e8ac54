// Orders that no kernel may rely on.
#pragma once

#include <cstddef>
#include <cstdint>
#include <numeric>
#include <utility>

// Numbers that look random, the same in each run that makes the same launches.
class Scrambler {
public:
    explicit Scrambler(uint64_t seed)
        : state_(seed * 0x9e3779b97f4a7c15u + 1)
    {
    }

    size_t below(size_t count)
    {
        state_ = state_ * 6364136223846793005u + 1442695040888963407u;
        return (size_t)((state_ >> 33) % count);
    }

    template <class T> void shuffle(T* items, size_t count)
    {
        for (size_t k = count; k > 1; --k)
            std::swap(items[k - 1], items[below(k)]);
    }

private:
    uint64_t state_;
};

// Numbers 0 … count-1, each once: with a stride that has no factor in common with the count, from anywhere on.
class ScrambledRange {
public:
    ScrambledRange(size_t count, Scrambler& scrambler)
        : count_(count)
        , start_(scrambler.below(count))
        , stride_(count < 3 ? 1 : 1 + scrambler.below(count - 1))
    {
        while (std::gcd(stride_, count_) != 1)
            ++stride_;
    }

    size_t operator[](size_t k) const { return (start_ + k * stride_) % count_; }

private:
    size_t count_, start_, stride_;
};
