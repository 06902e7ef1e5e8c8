// The threads of one call, which go through its phases together.
#pragma once
#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <mutex>
#include <thread>
#include <vector>

namespace deltamic_api {

// How many threads work of so many nanoseconds is worth: to start one and to wait for it took 0.2 ms
// where it was measured, and two paid from 0.7 ms on. Costs per item, where this is called, are of
// one thread of the same machine (Xeon, AVX-512).
inline int worth(double nanoseconds, int threads) {
    const double most = nanoseconds / 3.5e5;
    return most >= threads ? threads : most < 1 ? 1 : static_cast<int>(most);
}

class Team {
public:
    explicit Team(int threads) : size_(threads < 1 ? 1 : threads) {}

    int size() const { return size_; }

    // Runs work(worker) on every thread, the calling one among them.
    template <class F>
    void run(F work) {
        std::vector<std::thread> others;
        others.reserve(static_cast<std::size_t>(size_));
        {
            // None begins before it is known how many there are: the system may have no more.
            std::lock_guard<std::mutex> lock(mutex_);
            try {
                for (int i = 1; i < size_; ++i)
                    others.emplace_back([this, &work, i] {
                        { std::lock_guard<std::mutex> all_are_there(mutex_); }
                        work(i);
                    });
            } catch (...) {  // no more threads, or no memory for one
                size_ = static_cast<int>(others.size()) + 1;
            }
        }
        work(0);
        for (std::thread& t : others) t.join();
    }

    // Hands out items 0 ... count-1 of a phase to whoever is free; all wait for the last one.
    template <class F>
    void each(std::size_t count, F item) {
        for (;;) {
            const std::size_t i = next_.fetch_add(1);
            if (i >= count) break;
            item(i);
        }
        wait();
    }

    // One thread does it, the others wait.
    template <class F>
    void once(F work) {
        each(1, [&](std::size_t) { work(); });
    }

private:
    void wait() {
        std::unique_lock<std::mutex> lock(mutex_);
        const std::size_t phase = phase_;
        if (++waiting_ == size_) {
            waiting_ = 0;
            next_ = 0;
            ++phase_;
            arrived_.notify_all();
            return;
        }
        arrived_.wait(lock, [&] { return phase_ != phase; });
    }

    int size_;
    int waiting_ = 0;
    std::size_t phase_ = 0;
    std::atomic<std::size_t> next_{0};
    std::mutex mutex_;
    std::condition_variable arrived_;
};

}  // namespace deltamic_api
